"""Mass matrices between keypoints, positive by construction (paper, eq. (14))."""

import abc
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from keycld._errors import KeycldError


class AbstractMassMatrix(eqx.Module):
    """A constant mass matrix m [K, K] between keypoints; that of the coordinates [2K] is M = m ⊗ I₂.

    (M, V, g) is learned only up to one common factor, so ratios of masses are meaningful, not their values.
    """

    @property
    @abc.abstractmethod
    def matrix(self) -> Float[Array, "K K"]:
        """m, symmetric positive definite."""

    @property
    @abc.abstractmethod
    def inverse(self) -> Float[Array, "K K"]:
        """m⁻¹."""

    coupled: ClassVar[bool]
    """Whether m may have elements off the diagonal."""

    @abc.abstractmethod
    def nearest(self, matrix: Float[np.ndarray, "K K"]) -> "AbstractMassMatrix":
        """Return masses of the same kind with this positive definite m, or with its diagonal."""


class PointMasses(AbstractMassMatrix):
    """One mass a keypoint: m = diag(r₁², …, r_K²), eq. (14).

    Attributes:
        root: r [K], the square roots.
    """

    coupled: ClassVar[bool] = False

    root: Float[Array, "K"]

    @classmethod
    def ones(cls, count: int) -> "PointMasses":
        """Return masses of 1, as the 2024 version initialises them."""
        _check_count(count)
        return cls(jnp.ones((count,)))

    @classmethod
    def near_zero(cls, count: int, *, key: PRNGKeyArray) -> "PointMasses":
        """Return masses with roots from N(0, 0.01²), about 10⁻⁴ each, as the released code of arXiv v1 samples them."""
        _check_count(count)
        return cls(0.01 * jax.random.normal(key, (count,)))

    @property
    def matrix(self) -> Float[Array, "K K"]:
        """The masses on the diagonal."""
        return jnp.diag(self.root**2)

    @property
    def inverse(self) -> Float[Array, "K K"]:
        """Their inverses on the diagonal."""
        return jnp.diag(1 / self.root**2)

    def nearest(self, matrix: Float[np.ndarray, "K K"]) -> "PointMasses":
        """Return the masses on the diagonal of a matrix."""
        return PointMasses(jnp.sqrt(jnp.asarray(np.diagonal(matrix), self.root.dtype)))


class CoupledMasses(AbstractMassMatrix):
    """A full mass matrix: m⁻¹ = R Rᵀ.

    A rigid link whose mass is spread in any way along the line through keypoints i and j has the kinetic energy
    ½(mᵢᵢ|vᵢ|² + 2 mᵢⱼ vᵢ·vⱼ + mⱼⱼ|vⱼ|²), because every point of it moves as (1 − s) vᵢ + s vⱼ. Point masses alone
    (eq. 14) are exact only where each keypoint happens to sit at its link's centre of percussion.

    Attributes:
        root: R [K, K], of which the lower triangle counts.
    """

    coupled: ClassVar[bool] = True

    root: Float[Array, "K K"]

    @classmethod
    def ones(cls, count: int) -> "CoupledMasses":
        """Return uncoupled masses of 1."""
        _check_count(count)
        return cls(jnp.eye(count))

    @property
    def matrix(self) -> Float[Array, "K K"]:
        """The inverse of R Rᵀ."""
        return jnp.linalg.inv(self.inverse)

    @property
    def inverse(self) -> Float[Array, "K K"]:
        """R Rᵀ."""
        lower = jnp.tril(self.root)
        return jnp.matmul(lower, lower.T, precision="highest")

    def nearest(self, matrix: Float[np.ndarray, "K K"]) -> "CoupledMasses":
        """Return the masses with this matrix."""
        return CoupledMasses(jnp.asarray(np.linalg.cholesky(np.linalg.inv(matrix)), self.root.dtype))


def _check_count(count: int) -> None:
    if count < 1:
        raise KeycldError(f"a system has at least one keypoint, not {count}.")
