"""Constrained Lagrangian mechanics of point masses in Cartesian coordinates (paper, section 2 and A.1)."""

import abc
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.mechanics.constraints import AbstractConstraint, as_constraint
from keycld.mechanics.linear import gram, solve_positive, times
from keycld.mechanics.masses import AbstractMassMatrix
from keycld.mechanics.state import AbstractField, Motion


class AbstractLaw(AbstractField):
    """A law of motion of second order, x'' = a(x, x', u)."""

    @abc.abstractmethod
    def acceleration(
        self,
        x: Float[Array, "dim"],
        v: Float[Array, "dim"],
        u: Float[Array, "l"],
        parameters: dict[str, Any] | None = None,
    ) -> Float[Array, "dim"]:
        """Return a(x, v, u).

        Args:
            x: positions, flattened.
            v: velocities, units per second.
            u: the input [l].
            parameters: those of the trajectory's state.
        """

    def derivative(self, coordinates: Motion, u: Float[Array, "l"], parameters: dict[str, Any] | None = None) -> Motion:
        """Return (v, a): the law as an equation of first order."""
        x, v = coordinates
        return Motion(v, self.acceleration(x, v, u, parameters))


class AbstractLagrangian(AbstractLaw):
    """A law of motion with its energies."""

    @abc.abstractmethod
    def kinetic_energy(self, x: Float[Array, "dim"], v: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return T(x, v)."""

    @abc.abstractmethod
    def potential_energy(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return V(x)."""

    def energy(self, x: Float[Array, "dim"], v: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return T + V."""
        return self.kinetic_energy(x, v) + self.potential_energy(x)


class ConstrainedLagrangian(AbstractLagrangian):
    """Point masses with a potential energy, inputs and holonomic constraints.

    L = ½ vᵀMv − V(x), constraints Φ(x) = constant, forces f = −∇V(x) + g(x) u − ∂R/∂v (eqs. 17–20). R(x, v) is
    Rayleigh's dissipation function; the papers have none.
    The acceleration is eq. (6):

        a = M⁻¹f − M⁻¹DΦᵀ (DΦ M⁻¹ DΦᵀ)⁻¹ (DΦ M⁻¹ f + ⟨D²Φ, v⟩v)

    M, V, g (and R) are determined only up to one common factor, which cancels here.

    Args:
        mass: for instance `PointMasses`; M is its matrix [K, K] times I₂ (Kronecker product).
        potential: V, a callable x [2K] → number.
        input_matrix: g, a callable x [2K] → [2K, l]; None where there is no input.
        constraint: an `AbstractConstraint`, or a plain function `(x, parameters)` → [n]; None for free
            masses.
        dissipation: R, a callable (x [2K], v [2K]) → number; None for no friction.

    Raises:
        KeycldError: if the constraint belongs to another number of keypoints.
    """

    mass: AbstractMassMatrix
    potential: Callable
    input_matrix: Callable | None
    constraint_function: AbstractConstraint
    dissipation: Callable | None

    def __init__(self, mass, potential, input_matrix=None, constraint=None, dissipation=None):
        count = mass.inverse.shape[0]
        self.mass = mass
        self.potential = potential
        self.input_matrix = input_matrix
        self.constraint_function = as_constraint(_nothing if constraint is None else constraint, 2 * count)
        self.dissipation = dissipation

    @property
    def masses(self) -> Float[Array, "K"]:
        """Row sums of the mass matrix [K]: the point masses themselves, or a link's mass shared out to its keypoints.

        Their sum is what resists when all keypoints move together.
        """
        return jnp.sum(self.mass.matrix, axis=1)

    def times_mass(self, v: Float[Array, "*n dim"]) -> Float[Array, "*n dim"]:
        """Return M v, for a vector or the rows of a matrix."""
        return _by_keypoint(self.mass.matrix, v)

    def over_mass(self, f: Float[Array, "*n dim"]) -> Float[Array, "*n dim"]:
        """Return M⁻¹ f, for a vector or the rows of a matrix."""
        return _by_keypoint(self.mass.inverse, f)

    @property
    def count(self) -> int:
        """n, the number of constraints."""
        return self.constraint_function.count

    @property
    def freedom(self) -> int:
        """Degrees of freedom where no constraint repeats another; at least one."""
        return max(1, 2 * self.masses.shape[0] - self.count)

    @property
    def dissipative(self) -> bool:
        """Whether velocities cause forces."""
        return self.dissipation is not None

    @property
    def inputs(self) -> int:
        """l, the columns of g; 0 without an input matrix, where the acceleration ignores u."""
        if self.input_matrix is None:
            return 0
        return jax.eval_shape(self.input_matrix, jnp.zeros(2 * self.masses.shape[0])).shape[1]

    def constraint(self, x: Float[Array, "dim"], parameters: dict[str, Any] | None = None) -> Float[Array, "n"]:
        """Return Φ(x)."""
        return self.constraint_function(x, parameters)

    def jacobian(self, x: Float[Array, "dim"], parameters: dict[str, Any] | None = None) -> Float[Array, "n dim"]:
        """Return DΦ(x)."""
        return jax.jacfwd(self.constraint)(x, parameters)

    def force(self, x: Float[Array, "dim"], u: Float[Array, "l"]) -> Float[Array, "dim"]:
        """Return the force −∇V(x) + g(x) u, without friction."""
        return combine(self.fields(x), u)

    def friction(self, x: Float[Array, "dim"], v: Float[Array, "dim"]) -> Float[Array, "dim"]:
        """Return the force −∂R/∂v; zero without dissipation."""
        return jnp.zeros_like(v) if self.dissipation is None else -jax.grad(self.dissipation, argnums=1)(x, v)

    def fields(self, x: Float[Array, "dim"]) -> tuple[Float[Array, "dim"], Float[Array, "dim l"] | None]:
        """Return ∇V(x) and g(x): what an integrator keeps of a position, whatever the input will be."""
        return jax.grad(self.potential)(x), None if self.input_matrix is None else self.input_matrix(x)

    def acceleration(
        self,
        x: Float[Array, "dim"],
        v: Float[Array, "dim"],
        u: Float[Array, "l"],
        parameters: dict[str, Any] | None = None,
    ) -> Float[Array, "dim"]:
        """Compute the acceleration by eq. (6) of arXiv v1, with friction among the forces.

        The linear system is solved by a damped Cholesky factorisation: redundant constraints and vanishing
        Jacobians give finite accelerations. ⟨D²Φ, v⟩v is a second forward-mode derivative, the `jvp` of a `jvp`.
        """
        free = self.over_mass(self.force(x, u) + self.friction(x, v))
        jacobian = self.jacobian(x, parameters)
        if jacobian.shape[0] == 0:
            return free

        def rate(y):
            return jax.jvp(lambda z: self.constraint(z, parameters), (y,), (v,))[1]

        curvature = jax.jvp(rate, (x,), (v,))[1]
        pull = self.over_mass(jacobian)
        multipliers = solve_positive(gram(jacobian, pull), times(jacobian, free) + curvature)
        return free - times(pull.T, multipliers)

    def kinetic_energy(self, x: Float[Array, "dim"], v: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return T = ½ vᵀMv; it does not depend on the positions."""
        return 0.5 * jnp.sum(v * self.times_mass(v))

    def potential_energy(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return V(x)."""
        return self.potential(x)

    def project_velocity(
        self, x: Float[Array, "dim"], v: Float[Array, "dim"], parameters: dict[str, Any] | None = None
    ) -> Float[Array, "dim"]:
        """Project a velocity on ker DΦ(x) in the mass metric: the nearest one that the constraints allow, DΦ v = 0."""
        return tangential(self, self.jacobian(x, parameters), v)

    def project_position(
        self,
        x: Float[Array, "dim"],
        constants: Float[Array, "n"],
        parameters: dict[str, Any] | None = None,
        iterations: int = 3,
    ) -> Float[Array, "dim"]:
        """Return a near position with Φ(x) = constants, by damped Gauss–Newton iterations in the mass metric."""
        for _ in range(iterations if constants.shape[0] else 0):
            jacobian = self.jacobian(x, parameters)
            pull = self.over_mass(jacobian)
            defect = constants - self.constraint(x, parameters)
            x = x + times(pull.T, solve_positive(gram(jacobian, pull), defect))
        return x


def combine(
    fields: tuple[Float[Array, "dim"], Float[Array, "dim l"] | None], u: Float[Array, "l"]
) -> Float[Array, "dim"]:
    """Return the force −∇V + g u from the two fields at a position."""
    gradient, matrix = fields
    return -gradient if matrix is None else times(matrix, u) - gradient


def tangential(
    law: ConstrainedLagrangian, jacobian: Float[Array, "n dim"], v: Float[Array, "dim"]
) -> Float[Array, "dim"]:
    """Project v on ker DΦ in the mass metric: v − M⁻¹DΦᵀ(DΦ M⁻¹ DΦᵀ)⁻¹DΦ v."""
    if jacobian.shape[0] == 0:
        return v
    pull = law.over_mass(jacobian)
    return v - times(pull.T, solve_positive(gram(jacobian, pull), times(jacobian, v)))


def _by_keypoint(matrix: Float[Array, "K K"], vectors: Float[Array, "*n dim"]) -> Float[Array, "*n dim"]:
    """Apply (matrix ⊗ I₂) to a vector or rows, as a sum of products that XLA fuses."""
    split = vectors.reshape(*vectors.shape[:-1], 1, -1, 2)
    shape = (1,) * (vectors.ndim - 1) + (*matrix.shape, 1)
    return jnp.sum(matrix.reshape(shape) * split, axis=-2).reshape(vectors.shape)


def _nothing(x: Array, parameters: Any) -> Array:
    return x[:0]
