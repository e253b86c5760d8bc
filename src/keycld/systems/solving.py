"""Initial value problems solved to nearly double precision."""

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float

# The original solves with SciPy's RK45 at 1e-9 (toy physics) and 1e-12 (games).
TOLERANCE = 1e-10


def solve(
    derivative: Callable[[Array], Array],
    start: Float[Array, "d"],
    times: Float[Array, "T"],
    tolerance: float = TOLERANCE,
) -> Float[Array, "T d"]:
    """Compute the states at `times`, the first of which is the initial time, by Dormand–Prince 8(7) with dense output.

    One trajectory; `jax.vmap` it, inside `jax.enable_x64(True)`. Each trajectory has its own step size.

    Args:
        derivative: of the state, [d] → [d].
        start: the initial state, [d].
        times: rising.
        tolerance: relative and absolute, of a step.

    Good values: a tolerance of 1e-10 keeps energies to 1e-7 over 256 frames of the toy sets, 1e-12 the games.
    """
    import diffrax  # not at every start: it takes half a second, and few use it

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda _, y, __: derivative(y)),
        diffrax.Dopri8(),
        t0=times[0],
        t1=times[-1],
        dt0=None,
        y0=start,
        saveat=diffrax.SaveAt(ts=times),
        stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        adjoint=diffrax.ForwardMode(),  # plain loops; nothing is differentiated
        max_steps=None,
    )
    assert solution.ys is not None
    return jnp.asarray(solution.ys)
