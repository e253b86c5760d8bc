"""Fixed-step integrators: the interface, and Euler, mid-point, Runge–Kutta 4 and leapfrog for x'' = a(x, v, u)."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from keycld._errors import KeycldError
from keycld.mechanics.lagrangian import AbstractLaw, ConstrainedLagrangian, combine
from keycld.mechanics.state import Motion, Scalar, State

Parameters = dict[str, Any]


class AbstractIntegrator(eqx.Module):
    """One frame of motion in `substeps` equal steps, the input held; forward, or backward with negative dt.

    An integrator may remember what it knows at the end of a sub-step (forces, DΦ), because the next one
    continues from there: `initial_memory` makes that memory, `advance` takes one sub-step and renews it.

    What it integrates, `field` below, is an `AbstractLaw` or another `AbstractField`; each integrator says which
    ones it can follow.
    """

    substeps: eqx.AbstractVar[int]

    def __check_init__(self):
        """Refuse less than one sub-step."""
        if not isinstance(self.substeps, int) or self.substeps < 1:
            raise KeycldError(f"an integrator takes 1 or more sub-steps a frame, not {self.substeps!r}.")

    @abc.abstractmethod
    def initial_memory(self, field: Any, coordinates: Any, parameters: Parameters, h: Scalar) -> Any:
        """Return what `advance` needs to know of the initial state.

        Raises:
            KeycldError: for a field that this integrator cannot follow.
        """

    @abc.abstractmethod
    def advance(
        self, field: Any, coordinates: Any, memory: Any, parameters: Parameters, u: Float[Array, "l"], h: Scalar
    ) -> tuple[Any, Any]:
        """Take one sub-step of h seconds; return the coordinates and the memory after it."""

    def frame(
        self, field: Any, coordinates: Any, memory: Any, parameters: Parameters, u: Float[Array, "l"], dt: Scalar
    ) -> tuple[Any, Any]:
        """Take all sub-steps of one frame; return the coordinates and the memory after it."""
        h = dt / self.substeps
        if self.substeps == 1:
            return self.advance(field, coordinates, memory, parameters, u, h)

        def body(carry, _):
            return self.advance(field, carry[0], carry[1], parameters, u, h), None

        return jax.lax.scan(body, (coordinates, memory), length=self.substeps)[0]

    def step(self, field: Any, state: State, u: Float[Array, "l"], dt: Scalar) -> State:
        """Return the state one frame of `dt` seconds later."""
        memory = self.initial_memory(field, state.coordinates, state.parameters, dt / self.substeps)
        coordinates, _ = self.frame(field, state.coordinates, memory, state.parameters, u, dt)
        return State(coordinates, state.parameters)

    def rollout(
        self, field: Any, state: State, u: Float[Array, "l"] | Float[Array, "steps l"], dt: Scalar, steps: int
    ) -> PyTree:
        """Return the coordinates at `steps` + 1 frames, stacked, the given ones first.

        Args:
            field: what to integrate.
            state: the initial state.
            u: the input, constant [l] or one for each frame interval [steps, l]. For negative dt the latter
                is read in reverse, so a roll-out back over the same frames takes the same array.
            dt: seconds between frames.
            steps: number of frame intervals.

        Raises:
            KeycldError: if `u` does not fit, or for a field that this integrator cannot follow.
        """
        parameters = state.parameters
        first = state.coordinates
        memory = self.initial_memory(field, first, parameters, dt / self.substeps)

        def body(carry, u):
            coordinates, memory = self.frame(field, carry[0], carry[1], parameters, u, dt)
            return (coordinates, memory), coordinates

        _, rest = jax.lax.scan(body, (first, memory), frame_inputs(u, dt, steps))
        return stack_first(first, rest)


def frame_inputs(u: Float[Array, "l"] | Float[Array, "steps l"], dt: Scalar, steps: int) -> Float[Array, "steps l"]:
    """Return the input of each frame interval in the order of integration: reversed for negative dt.

    Raises:
        KeycldError: if there are not as many as steps.
    """
    if u.ndim == 1:
        return jnp.broadcast_to(u[None, :], (steps, u.shape[0]))
    if u.shape[0] != steps:
        raise KeycldError(f"a roll-out of {steps} steps needs {steps} inputs, not {u.shape[0]}: cut or extend u.")
    return jnp.where(jnp.asarray(dt) < 0, u[::-1], u)


def stack_first(first: PyTree, rest: PyTree) -> PyTree:
    """Stack coordinates in front of those that are stacked already."""
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, rest)


class Euler(AbstractIntegrator):
    """Explicit Euler: x' = x + h v, v' = v + h a(x, v). Order 1; gains energy. The 2024 version's loss uses it."""

    substeps: int = eqx.field(static=True, default=1)

    def initial_memory(self, law: AbstractLaw, motion: Motion, parameters: Parameters, h: Scalar) -> None:
        """Return None: there is nothing to remember."""

    def advance(
        self,
        law: AbstractLaw,
        motion: Motion,
        memory: None,
        parameters: Parameters,
        u: Float[Array, "l"],
        h: Scalar,
    ) -> tuple[Motion, None]:
        """Take one step."""
        x, v = motion
        return Motion(x + h * v, v + h * law.acceleration(x, v, u, parameters)), None


class RK2(AbstractIntegrator):
    """The mid-point rule, order 2: the derivative after half a step of Euler serves for the whole step."""

    substeps: int = eqx.field(static=True, default=1)

    def initial_memory(self, law: AbstractLaw, motion: Motion, parameters: Parameters, h: Scalar) -> None:
        """Return None: there is nothing to remember."""

    def advance(
        self,
        law: AbstractLaw,
        motion: Motion,
        memory: None,
        parameters: Parameters,
        u: Float[Array, "l"],
        h: Scalar,
    ) -> tuple[Motion, None]:
        """Take one step."""
        x, v = motion
        middle = v + h / 2 * law.acceleration(x, v, u, parameters)
        slope = law.acceleration(x + h / 2 * v, middle, u, parameters)
        return Motion(x + h * middle, v + h * slope), None


class RK4(AbstractIntegrator):
    """The classical Runge–Kutta method, order 4: accurate over short spans, not symplectic."""

    substeps: int = eqx.field(static=True, default=1)

    def initial_memory(self, law: AbstractLaw, motion: Motion, parameters: Parameters, h: Scalar) -> None:
        """Return None: there is nothing to remember."""

    def advance(
        self,
        law: AbstractLaw,
        motion: Motion,
        memory: None,
        parameters: Parameters,
        u: Float[Array, "l"],
        h: Scalar,
    ) -> tuple[Motion, None]:
        """Take one step."""
        x, v = motion
        a1 = law.acceleration(x, v, u, parameters)
        v2 = v + h / 2 * a1
        a2 = law.acceleration(x + h / 2 * v, v2, u, parameters)
        v3 = v + h / 2 * a2
        a3 = law.acceleration(x + h / 2 * v2, v3, u, parameters)
        v4 = v + h * a3
        a4 = law.acceleration(x + h * v3, v4, u, parameters)
        x = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
        v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        return Motion(x, v), None


class Leapfrog(AbstractIntegrator):
    """Leapfrog, or velocity Verlet: half a kick, a drift, half a kick. Order 2, symplectic, reversible.

    Only for forces that do not depend on velocities: no constraints, no damping.
    """

    substeps: int = eqx.field(static=True, default=1)

    def initial_memory(self, law: AbstractLaw, motion: Motion, parameters: Parameters, h: Scalar) -> Any:
        """Return ∇V and g at the initial position.

        Raises:
            KeycldError: for a law with constraints or damping.
        """
        if not isinstance(law, ConstrainedLagrangian) or law.dissipative or law.constraint(motion.x, parameters).size:
            raise KeycldError(
                "leapfrog integrates point masses without constraints or damping: use Rattle for this law."
            )
        return law.fields(motion.x)

    def advance(
        self,
        law: ConstrainedLagrangian,
        motion: Motion,
        memory: Any,
        parameters: Parameters,
        u: Float[Array, "l"],
        h: Scalar,
    ) -> tuple[Motion, Any]:
        """Take one step."""
        middle = motion.v + h / 2 * law.over_mass(combine(memory, u))
        x = motion.x + h * middle
        fields = law.fields(x)
        return Motion(x, middle + h / 2 * law.over_mass(combine(fields, u))), fields
