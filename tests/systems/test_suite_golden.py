"""Toy physics and games equal the suite's own generator: states, derivatives and pictures of its files."""

from functools import lru_cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.systems import AbstractInitialValueSystem, Recording, get, names, soft_discs, to_bytes
from keycld.systems.discs import hue_colours

GOLDEN = Path(__file__).parent / "golden" / "suite"
NAMES = names(AbstractInitialValueSystem)
RENDERED = [path.stem for path in sorted(GOLDEN.glob("render_*.npz"))]


@lru_cache
def golden(name):
    """States [3, 64, d] of the suite, parameters as ours, and the numbers of the frames that have pictures."""
    found = np.load(GOLDEN / f"{name.split('/')[1]}.npz")
    parameters = {key.removeprefix("param_"): found[key] for key in found if key.startswith("param_")}
    if "offset" in found:
        parameters["offset"] = np.broadcast_to(found["offset"], (3, 2))
        parameters["color_index"] = found["color_index"]
        parameters["canvas"] = np.full(3, found["canvas_limits"][1])
    return found, parameters


def test_all_of_the_suite_that_can_be_generated_is_compared():
    assert {path.stem for path in GOLDEN.glob("*.npz")} - set(RENDERED) == {name.split("/")[1] for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_motion(name):
    system, (found, parameters) = get(name), golden(name)
    state = system.move(found["x"][:, 0], parameters, system.dt * np.arange(64))
    assert system.dt == found["dt"]
    np.testing.assert_allclose(state, found["x"], atol=1e-4 if "double" in name else 1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_with_friction(name):
    system, (found, parameters) = get(name), golden(name)
    derivative = system.derivatives(found["x"][:, found["frames"]], parameters)
    np.testing.assert_allclose(derivative, found["derivative"], atol=1e-13)


@pytest.mark.parametrize("name", NAMES)
def test_pictures(name):
    system, (found, parameters) = get(name), golden(name)
    state, frames = found["x"][:, found["frames"]], found["frames"]
    with jax.enable_x64(True):
        render = jax.vmap(jax.vmap(lambda state, constants: to_bytes(system.picture(state, constants)), (0, None)))
        np.testing.assert_array_equal(jax.jit(render)(state, parameters), found["image"])
    single = system.pictures(Recording(system.dt * frames, state, parameters)).image
    difference = np.abs(single.astype(int) - found["image"])
    assert difference.max() <= 1 and np.mean(difference > 0) <= 1e-3


@pytest.mark.parametrize("name", [name for name in NAMES if name.startswith("toy/")])
def test_canvas(name):
    """The half width of ours, with the room for random places where there is any, is the suite's."""
    system, (found, _) = get(name), golden(name)
    _, sampled = system.initial_state(np.random.RandomState(0), "priors-released")
    assert sampled["canvas"] == pytest.approx(found["canvas_limits"][1], rel=1e-12)
    assert sampled["color_index"].shape == found["color_index"].shape[1:]


@pytest.mark.parametrize("name", RENDERED)
def test_the_renderer_alone(name):
    case = np.load(GOLDEN / f"{name}.npz")
    colours = hue_colours(int(case["num_colors"]))[case["color_indices"]]

    def render(kind):
        fixed = [jnp.asarray(case["radii"], kind), jnp.asarray(colours, kind), jnp.asarray(case["canvas_limits"], kind)]
        rendered = jax.jit(jax.vmap(lambda centres: to_bytes(soft_discs(centres, *fixed))))
        return np.asarray(rendered(jnp.asarray(case["positions"], kind)))

    with jax.enable_x64(True):
        np.testing.assert_array_equal(render(jnp.float64), case["image_uint8"])
    difference = np.abs(render(jnp.float32).astype(int) - case["image_uint8"])
    assert difference.max() <= 1 and np.mean(difference > 0) <= 1e-4


@pytest.mark.parametrize("radius", [0.4, 0.8, 1.4])
@pytest.mark.parametrize("hues", [2, 6])
def test_saturated_interiors_of_overlapping_discs_have_the_same_bytes_in_single_precision(radius, hues):
    """Where discs of full colour overlap, 1 − value is the product of what both let through: 254, not 255."""
    random, canvas = np.random.RandomState(0), np.array([-2.0, 2.0])
    centres, colours = random.uniform(-1.0, 1.0, (100, 2, 2)), hue_colours(hues)[[0, hues - 1]]

    def render(kind):
        fixed = [jnp.asarray(value, kind) for value in (np.full(2, radius), colours, canvas)]
        return np.asarray(jax.jit(jax.vmap(lambda c: to_bytes(soft_discs(c, *fixed))))(jnp.asarray(centres, kind)))

    with jax.enable_x64(True):
        exact = render(jnp.float64)
    single = render(jnp.float32)
    saturated = exact >= 254
    assert np.mean(saturated) > 1e-3
    np.testing.assert_array_equal(single[saturated], exact[saturated])
    np.testing.assert_array_equal(single >= 254, saturated)
    assert np.mean(single != exact) < 1e-4
