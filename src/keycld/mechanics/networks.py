"""Small models of potential energy and input matrix (paper, appendix A.4).

Their activation is the paper's CELU, whose gradient is continuous: a force is the gradient of the potential
energy, and the kinks of a ReLU would make it jump.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld._errors import KeycldError


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
        """Return the last layer's values, without activation."""
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
        """Return V(x); only differences of it matter."""
        return self.perceptron(x)[0]


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
        """Return g(x)."""
        if self.perceptron is None:
            return jnp.zeros((self.dim, 0), x.dtype)
        return self.perceptron(x).reshape(self.dim, self.inputs)


class AffineMLPInputMatrix(eqx.Module):
    """g(x) = reshape(A x + b) + perceptron: forces of motors on slides and hinges are affine in keypoints.

    Attributes:
        weight: A [2K·l, 2K], zero before training; row i·l + j belongs to g[i, j].
        bias: b [2K·l], zero before training.
        perceptron: the rest, near zero before training; None: there is no rest.
    """

    weight: Float[Array, "outputs dim"]
    bias: Float[Array, "outputs"]
    perceptron: MLPInputMatrix | None

    def __init__(self, dim: int, inputs: int, width: int = 32, *, key: PRNGKeyArray):
        """Make the matrix; without a perceptron if `width` is 0."""
        self.weight = jnp.zeros((dim * inputs, dim))
        self.bias = jnp.zeros((dim * inputs,))
        self.perceptron = MLPInputMatrix(dim, inputs, width, key=key) if width else None

    def __call__(self, x: Float[Array, "dim"]) -> Float[Array, "dim inputs"]:
        """Return g(x)."""
        affine = (jnp.matmul(self.weight, x, precision="highest") + self.bias).reshape(x.shape[0], -1)
        return affine if self.perceptron is None else affine + self.perceptron(x)
