"""Dense layers as in Haiku, of which "Which priors matter?" builds its energies, fields and recurrent cells."""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld._errors import KeycldError

_ROW = 2**15
_CUT = 0.87962566103423978
"""Deviation of a normal distribution of deviation 1 that is cut at 2."""


def truncated_normal(key: PRNGKeyArray, shape: tuple[int, int]) -> Float[Array, "inputs outputs"]:
    """Sample a kernel from N(0, 1/inputs) cut at two deviations, which leaves 0.88 of the deviation.

    Haiku's default for dense layers and convolutions. `lecun_normal` makes up for the cut.
    """
    # The first numbers of a long row are those of a short one, so that kernels of many shapes share one program. To
    # compile one for each took a hundredth of a first training.
    count = math.prod(shape)
    row = jax.random.truncated_normal(key, -2.0, 2.0, (-(-count // _ROW) * _ROW,))
    return row[:count].reshape(shape) / jnp.sqrt(shape[0])


def lecun_normal(key: PRNGKeyArray, shape: tuple[int, int]) -> Float[Array, "inputs outputs"]:
    """Sample a kernel from a normal distribution cut at two deviations that has the variance 1/inputs.

    Flax's default for dense layers and convolutions.
    """
    return truncated_normal(key, shape) / _CUT


class Linear(eqx.Module):
    """y = W x + b; at first W by `truncated_normal`, b = 0.

    Attributes:
        kernel: Wᵀ.
        bias: b.
    """

    kernel: Float[Array, "inputs outputs"]
    bias: Float[Array, "outputs"]

    def __init__(self, inputs: int, outputs: int, *, key: PRNGKeyArray):
        if min(inputs, outputs) < 1:
            raise KeycldError(f"a dense layer has at least one input and one output, not {inputs} and {outputs}.")
        self.kernel = truncated_normal(key, (inputs, outputs))
        self.bias = jnp.zeros(outputs)

    def __call__(self, x: Float[Array, "inputs"]) -> Float[Array, "outputs"]:
        """Return W x + b."""
        return jnp.matmul(x, self.kernel, precision="highest") + self.bias


class SwishMLP(eqx.Module):
    """Dense layers with swish, x · sigmoid(x), between them and nothing after the last.

    Swish is smooth, so the gradient of an energy made of it is a smooth force. The networks of "Which priors matter?"
    have four hidden layers of 250 units.

    Attributes:
        layers: one more than there are hidden layers.
    """

    layers: tuple[Linear, ...]

    def __init__(self, inputs: int, outputs: int, hidden: int = 250, depth: int = 4, *, key: PRNGKeyArray):
        """Build the layers.

        Args:
            inputs: size of x.
            outputs: size of the last layer.
            hidden: units of each hidden layer.
            depth: how many hidden layers.
            key: of the random kernels.
        """
        sizes = [inputs, *[hidden] * depth, outputs]
        keys = jax.random.split(key, depth + 1)
        self.layers = tuple(Linear(a, b, key=k) for a, b, k in zip(sizes[:-1], sizes[1:], keys, strict=True))

    def __call__(self, x: Float[Array, "inputs"]) -> Float[Array, "outputs"]:
        """Return the values of the last layer."""
        for layer in self.layers[:-1]:
            x = jax.nn.swish(layer(x))
        return self.layers[-1](x)


def begin_as_identity(network: SwishMLP, *, key: PRNGKeyArray) -> SwishMLP:
    """Return a network of the same sizes that is the identity before training: y = the first entries of x.

    Hidden units come in pairs of opposite sign, and swish(z) − swish(−z) = z: the network is linear at first
    ("looks-linear" weights, Balduzzi et al. 2017, section 4).

    Args:
        network: the sizes.
        key: of random rotations between the layers.

    Raises:
        KeycldError: a hidden layer has less than two units for each input.
    """
    inputs, hidden = network.layers[0].kernel.shape
    outputs, pairs = network.layers[-1].kernel.shape[1], hidden // 2
    if pairs < inputs or outputs > inputs:
        raise KeycldError(
            f"a network that begins as the identity of {inputs} numbers has at least {2 * inputs} hidden units and at "
            f"most {inputs} outputs, not {hidden} and {outputs}."
        )
    turns = [jax.random.orthogonal(each, pairs) for each in jax.random.split(key, len(network.layers) - 1)]
    turns[0] = turns[0][:inputs]
    back = functools.reduce(jnp.matmul, turns).T[:, :outputs]
    kernels = [
        jnp.concatenate([turns[0], -turns[0]], axis=1),
        *(jnp.block([[turn, -turn], [-turn, turn]]) for turn in turns[1:]),
        jnp.concatenate([back, -back]),
    ]
    padded = [
        jnp.pad(kernel, [(0, most - size) for most, size in zip(layer.kernel.shape, kernel.shape, strict=True)])
        for kernel, layer in zip(kernels, network.layers, strict=True)
    ]
    return eqx.tree_at(lambda n: [layer.kernel for layer in n.layers], network, padded)


class SwishEnergy(eqx.Module):
    """A scalar energy by a `SwishMLP`, such as T(p) or V(q); only differences of it matter.

    Attributes:
        network: with one output.
    """

    network: SwishMLP

    def __init__(self, dim: int, hidden: int = 250, depth: int = 4, *, key: PRNGKeyArray):
        self.network = SwishMLP(dim, 1, hidden, depth, key=key)

    def __call__(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return the energy."""
        return self.network(x)[0]
