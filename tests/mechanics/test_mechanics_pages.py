"""The code of the room's pages runs as printed."""

import re
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.mechanics import Constraints, force, parse_constraints, term_kinds

DOCS = Path(__file__).parents[2] / "docs"


def run(page):
    """Everything that the page's Python defines."""
    names = {"__name__": "page"}
    for block in re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(), re.DOTALL):
        exec(block, names)
    return names


def test_mechanics(monkeypatch):
    # The page's own kind of force is for this test alone.
    term_kinds()
    monkeypatch.setattr(force, "_KINDS", dict(force._KINDS))
    page = run("mechanics.md")
    assert page["Wind"].kind in term_kinds()
    push = eqx.tree_at(
        lambda wind: wind.push, page["Wind"].zero(Constraints(("a", "b"), ()), key=None), jnp.array([1.0, 2.0])
    )
    np.testing.assert_allclose(-jax.grad(push, argnums=1)(jnp.ones(4), jnp.ones(4)), [1, 2, 1, 2])
    energy = np.asarray(page["energy"])
    # The torque u = 0.5 does the work u θ on the bob.
    x = np.asarray(page["motion"].x)
    angle = np.unwrap(np.arctan2(x[:, 1], x[:, 0]))
    np.testing.assert_allclose(energy - energy[0], 0.5 * angle, atol=5e-3)
    assert page["path"].q.shape == (51, 1)
    np.testing.assert_allclose(page["again"].inertia, page["rod"].inertia)


def test_constraints():
    page = run("constraints.md")
    again = parse_constraints(page["text"], "the page")
    assert again == page["weights"]
    np.testing.assert_allclose(again(jnp.array([-0.5, 0.0, 0.5, 0.2])), [1.4], rtol=1e-6)


@pytest.mark.parametrize("block", re.findall(r"```toml\n(.*?)```", (DOCS / "constraints.md").read_text(), re.DOTALL))
def test_constraints_in_a_file(block):
    assert parse_constraints(block, "the page").count == 3
