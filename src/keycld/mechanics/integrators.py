"""Fixed-step integrators of x'' = a(x, v, u): explicit Euler, mid-point, Runge–Kutta 4, leapfrog."""

import abc
from typing import Any

import equinox as eqx
import jax
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics.lagrangian import AbstractLaw, ConstrainedLagrangian, combine
from keycld.mechanics.state import Motion, Scalar, State

Parameters = dict[str, Any]


class AbstractIntegrator(eqx.Module):
    """One frame of motion in `substeps` equal steps, the input held; forward, or backward with negative dt.

    An integrator may remember what it knows at the end of a sub-step (forces, DΦ), because the next one
    starts there: `begin` makes that memory, `advance` takes one sub-step and renews it.
    """

    substeps: eqx.AbstractVar[int]

    def __check_init__(self):
        """At least one sub-step."""
        if not isinstance(self.substeps, int) or self.substeps < 1:
            raise KeycldError(f"an integrator takes 1 or more sub-steps a frame, not {self.substeps!r}.")

    @abc.abstractmethod
    def begin(self, law: AbstractLaw, motion: Motion, parameters: Parameters, h: Scalar) -> Any:
        """What `advance` wants to know at the start.

        Raises:
            KeycldError: for a law that this integrator cannot follow.
        """

    @abc.abstractmethod
    def advance(
        self, law: Any, motion: Motion, memory: Any, parameters: Parameters, u: Float[Array, "l"], h: Scalar
    ) -> tuple[Motion, Any]:
        """One sub-step of h seconds."""

    def frame(
        self, law: Any, motion: Motion, memory: Any, parameters: Parameters, u: Float[Array, "l"], dt: Scalar
    ) -> tuple[Motion, Any]:
        """All sub-steps of one frame."""
        h = dt / self.substeps
        if self.substeps == 1:
            return self.advance(law, motion, memory, parameters, u, h)

        def body(carry, _):
            return self.advance(law, carry[0], carry[1], parameters, u, h), None

        return jax.lax.scan(body, (motion, memory), length=self.substeps)[0]

    def step(self, law: AbstractLaw, state: State, u: Float[Array, "l"], dt: Scalar) -> State:
        """The state one frame of `dt` seconds later."""
        motion = state.coordinates
        memory = self.begin(law, motion, state.parameters, dt / self.substeps)
        motion, _ = self.frame(law, motion, memory, state.parameters, u, dt)
        return State(motion, state.parameters)


class Euler(AbstractIntegrator):
    """Explicit Euler: x' = x + h v, v' = v + h a(x, v). Order 1; gains energy. The 2024 paper's roll-outs."""

    substeps: int = eqx.field(static=True, default=1)

    def begin(self, law: AbstractLaw, motion: Motion, parameters: Parameters, h: Scalar) -> None:
        """Nothing to remember."""

    def advance(
        self,
        law: AbstractLaw,
        motion: Motion,
        memory: None,
        parameters: Parameters,
        u: Float[Array, "l"],
        h: Scalar,
    ) -> tuple[Motion, None]:
        """One step."""
        x, v = motion
        return Motion(x + h * v, v + h * law.acceleration(x, v, u, parameters)), None


class RK2(AbstractIntegrator):
    """The mid-point rule, order 2: the derivative half a step of Euler ahead serves for the whole step."""

    substeps: int = eqx.field(static=True, default=1)

    def begin(self, law: AbstractLaw, motion: Motion, parameters: Parameters, h: Scalar) -> None:
        """Nothing to remember."""

    def advance(
        self,
        law: AbstractLaw,
        motion: Motion,
        memory: None,
        parameters: Parameters,
        u: Float[Array, "l"],
        h: Scalar,
    ) -> tuple[Motion, None]:
        """One step."""
        x, v = motion
        middle = v + h / 2 * law.acceleration(x, v, u, parameters)
        slope = law.acceleration(x + h / 2 * v, middle, u, parameters)
        return Motion(x + h * middle, v + h * slope), None


class RK4(AbstractIntegrator):
    """The classical Runge–Kutta method, order 4: accurate over short spans, not symplectic."""

    substeps: int = eqx.field(static=True, default=1)

    def begin(self, law: AbstractLaw, motion: Motion, parameters: Parameters, h: Scalar) -> None:
        """Nothing to remember."""

    def advance(
        self,
        law: AbstractLaw,
        motion: Motion,
        memory: None,
        parameters: Parameters,
        u: Float[Array, "l"],
        h: Scalar,
    ) -> tuple[Motion, None]:
        """One step."""
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

    def begin(self, law: AbstractLaw, motion: Motion, parameters: Parameters, h: Scalar) -> Any:
        """∇V and g at the start.

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
        """One step."""
        middle = motion.v + h / 2 * law.over_mass(combine(memory, u))
        x = motion.x + h * middle
        fields = law.fields(x)
        return Motion(x, middle + h / 2 * law.over_mass(combine(fields, u))), fields
