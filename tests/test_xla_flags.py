import os
import subprocess
import sys

import pytest

from keycld._xla_flags import avoid_faulty_kernels

# Each of them, without the flag and with jaxlib 0.10.2: a sum that is wrong by .6 %, and signal 11.
LONG_SUM = """
i = jnp.arange(32769.0)
rows = jnp.stack([i, 0 * i, 0 * i], axis=1)
squares = jax.jit(jax.vmap(lambda row: jnp.sum((jnp.eye(3) @ row) ** 2)))(rows)
assert abs(float(squares[-1]) / 32768.0**2 - 1) < 1e-5, squares[-1]
"""
SEVEN_DIMENSIONS = """
a = jax.random.normal(jax.random.key(0), (3, 1, 2, 2, 8, 8, 8))
total = jax.jit(lambda a, b: jnp.sum(a * b, axis=3))(a, a)
assert jnp.allclose(total, a[:, :, :, 0] ** 2 + a[:, :, :, 1] ** 2, rtol=1e-5)
"""


@pytest.mark.parametrize("program", [LONG_SUM, SEVEN_DIMENSIONS])
def test_sums_on_a_cpu_are_right(program):
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    code = f"import jax, jax.numpy as jnp\nimport keycld\n{program}"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment | {"JAX_PLATFORMS": "cpu"}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-500:]


def test_flags_of_the_user_stay(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_experimental_ynn_fusion_type=individual_dot")
    avoid_faulty_kernels()
    assert os.environ["XLA_FLAGS"] == "--xla_cpu_experimental_ynn_fusion_type=individual_dot"
