"""Dynamics of first order: a Hamiltonian or another field with an integrator."""

from jaxtyping import Array, Float, PyTree

from keycld.mechanics.hamiltonian import AbstractHamiltonian
from keycld.mechanics.integrators import AbstractIntegrator
from keycld.mechanics.state import AbstractDynamics, AbstractField, PhasePoint, Scalar, State


class FirstOrderDynamics(AbstractDynamics):
    """A field ds/dt = F(s, u), integrated with fixed steps.

    Attributes:
        field: any `AbstractField`, for instance a learned one; s is any pytree of arrays.
        integrator: for instance `integrator_named("rk4")`.
    """

    field: AbstractField
    integrator: AbstractIntegrator

    def step(self, state: State, u: Float[Array, "l"], dt: Scalar) -> State:
        """Return the state one frame later (earlier for negative dt)."""
        return self.integrator.step(self.field, state, u, dt)

    def rollout(self, state: State, u: Float[Array, "l"] | Float[Array, "steps l"], dt: Scalar, steps: int) -> PyTree:
        """Return the coordinates at `steps` + 1 frames; see `AbstractIntegrator.rollout`."""
        return self.integrator.rollout(self.field, state, u, dt, steps)


class HamiltonianDynamics(AbstractDynamics):
    """Hamilton's equations q̇ = ∂H/∂p, ṗ = −∂H/∂q + g(q) u, integrated with fixed steps.

    The coordinates of its states are a `PhasePoint`. Negative dt runs backward.

    Attributes:
        hamiltonian: a `SeparableHamiltonian`, or any other for Runge–Kutta methods.
        integrator: for instance `integrator_named("leap_frog")`.
    """

    hamiltonian: AbstractHamiltonian
    integrator: AbstractIntegrator

    def step(self, state: State, u: Float[Array, "l"], dt: Scalar) -> State:
        """Return the state one frame later (earlier for negative dt)."""
        return self.integrator.step(self.hamiltonian, state, u, dt)

    def rollout(
        self, state: State, u: Float[Array, "l"] | Float[Array, "steps l"], dt: Scalar, steps: int
    ) -> PhasePoint:
        """Return q [steps + 1, m] and p [steps + 1, m], the given point first; see `AbstractIntegrator.rollout`."""
        return self.integrator.rollout(self.hamiltonian, state, u, dt, steps)
