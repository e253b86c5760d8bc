"""Small models of mass, potential energy and input matrix (paper, appendix A.4 and eq. (14)).

Their activation is the paper's CELU, whose gradient is continuous: a force is the gradient of the potential
energy, and the kinks of a ReLU would make it jump.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld._errors import KeycldError


class PointMasses(eqx.Module):
    """One mass a keypoint, positive by construction: mᵢ = rᵢ², eq. (14).

    (M, V, g) is learned only up to one common factor, so ratios of masses are meaningful, not their values.

    Attributes:
        root: r [K], the square roots.
    """

    root: Float[Array, "K"]

    @classmethod
    def ones(cls, count: int) -> "PointMasses":
        """The paper's start: every mass is 1."""
        if count < 1:
            raise KeycldError(f"a system has at least one keypoint, not {count}.")
        return cls(jnp.ones((count,)))

    @property
    def matrix(self) -> Float[Array, "K K"]:
        """M = diag(m)."""
        return jnp.diag(self.root**2)

    @property
    def inverse(self) -> Float[Array, "K K"]:
        """M⁻¹ = diag(1/m)."""
        return jnp.diag(1 / self.root**2)


class CoupledMasses(eqx.Module):
    """A constant mass matrix between keypoints, positive by construction: M⁻¹ = R Rᵀ.

    A rigid link whose mass is spread in any way along the line through keypoints i and j has the kinetic energy
    ½(Mᵢᵢ|vᵢ|² + 2 Mᵢⱼ vᵢ·vⱼ + Mⱼⱼ|vⱼ|²), because every point of it moves as (1 − s) vᵢ + s vⱼ. Point masses alone
    (eq. 14) are exact only where each keypoint happens to sit at its link's centre of percussion. Known up to one
    factor, like every mass.

    Attributes:
        root: R [K, K], of which the lower triangle counts.
    """

    root: Float[Array, "K K"]

    @classmethod
    def ones(cls, count: int) -> "CoupledMasses":
        """Uncoupled masses of 1."""
        if count < 1:
            raise KeycldError(f"a system has at least one keypoint, not {count}.")
        return cls(jnp.eye(count))

    @property
    def matrix(self) -> Float[Array, "K K"]:
        """M."""
        return jnp.linalg.inv(self.inverse)

    @property
    def inverse(self) -> Float[Array, "K K"]:
        """M⁻¹ = R Rᵀ."""
        lower = jnp.tril(self.root)
        return jnp.matmul(lower, lower.T, precision="highest")


class Perceptron(eqx.Module):
    """Dense layers with CELU between them; kernels N(0, 0.01²), biases zero (appendix A.4)."""

    kernels: tuple[Array, ...]
    biases: tuple[Array, ...]

    def __init__(self, sizes: tuple[int, ...], key: PRNGKeyArray):
        if min(sizes) < 1:
            raise KeycldError(f"a layer has at least one unit, but the sizes are {sizes}.")
        keys = jax.random.split(key, len(sizes) - 1)
        pairs = list(zip(sizes[:-1], sizes[1:], strict=True))
        self.kernels = tuple(0.01 * jax.random.normal(k, pair) for k, pair in zip(keys, pairs, strict=True))
        self.biases = tuple(jnp.zeros((size,)) for size in sizes[1:])

    def __call__(self, x: Float[Array, "inputs"]) -> Float[Array, "outputs"]:
        """The last layer's values, without activation."""
        last = len(self.kernels) - 1
        for k, (kernel, bias) in enumerate(zip(self.kernels, self.biases, strict=True)):
            x = jnp.matmul(x, kernel, precision="highest") + bias
            x = jax.nn.celu(x) if k < last else x
        return x


class MLPPotential(eqx.Module):
    """Potential energy V(x) by a perceptron 2K-width-width-1."""

    perceptron: Perceptron

    def __init__(self, dim: int, width: int = 32, *, key: PRNGKeyArray):
        self.perceptron = Perceptron((dim, width, width, 1), key)

    def __call__(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """V(x); only differences of it matter."""
        return self.perceptron(x)[0]


class AffineMLPPotential(eqx.Module):
    """V(x) = w·x + perceptron: gravity is linear in keypoints, so least squares finds w before training.

    Attributes:
        weight: w [2K], zero at first.
        perceptron: the rest; starts near zero.
    """

    weight: Float[Array, "dim"]
    perceptron: Perceptron

    def __init__(self, dim: int, width: int = 32, *, key: PRNGKeyArray):
        self.weight = jnp.zeros((dim,))
        self.perceptron = Perceptron((dim, width, width, 1), key)

    def __call__(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """V(x)."""
        return jnp.sum(self.weight * x) + self.perceptron(x)[0]


class MLPInputMatrix(eqx.Module):
    """Input matrix g(x) [2K, l] by a perceptron 2K-width-width-2K·l; without inputs (l = 0) it is empty."""

    perceptron: Perceptron | None
    dim: int = eqx.field(static=True)
    inputs: int = eqx.field(static=True)

    def __init__(self, dim: int, inputs: int, width: int = 32, *, key: PRNGKeyArray):
        self.perceptron = Perceptron((dim, width, width, dim * inputs), key) if inputs else None
        self.dim = dim
        self.inputs = inputs

    def __call__(self, x: Float[Array, "dim"]) -> Float[Array, "dim inputs"]:
        """g(x)."""
        if self.perceptron is None:
            return jnp.zeros((self.dim, 0), x.dtype)
        return self.perceptron(x).reshape(self.dim, self.inputs)


class AffineMLPInputMatrix(eqx.Module):
    """g(x) = reshape(A x + b) + perceptron: forces of motors on slides and hinges are affine in keypoints.

    Attributes:
        weight: A [2K·l, 2K], zero at first; row i·l + j belongs to g[i, j].
        bias: b [2K·l], zero at first.
        perceptron: the rest; starts near zero.
    """

    weight: Float[Array, "outputs dim"]
    bias: Float[Array, "outputs"]
    perceptron: MLPInputMatrix

    def __init__(self, dim: int, inputs: int, width: int = 32, *, key: PRNGKeyArray):
        self.weight = jnp.zeros((dim * inputs, dim))
        self.bias = jnp.zeros((dim * inputs,))
        self.perceptron = MLPInputMatrix(dim, inputs, width, key=key)

    def __call__(self, x: Float[Array, "dim"]) -> Float[Array, "dim inputs"]:
        """g(x)."""
        affine = jnp.matmul(self.weight, x, precision="highest") + self.bias
        return affine.reshape(self.perceptron.dim, self.perceptron.inputs) + self.perceptron(x)
