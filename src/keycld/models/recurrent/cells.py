"""Recurrent cells with the equations and initial values of Haiku, and a stack of them."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics import Linear, lecun_normal


class AbstractCell(eqx.Module):
    """One step of a recurrence: (memory, x) → (memory, output)."""

    hidden: eqx.AbstractVar[int]

    @abstractmethod
    def initial(self) -> Any:
        """Return the memory before the first step: zeros."""

    @abstractmethod
    def __call__(self, memory: Any, x: Float[Array, "inputs"]) -> tuple[Any, Float[Array, "hidden"]]:
        """Take one step; return the memory after it and the output."""


class VanillaCell(AbstractCell):
    """The output is the memory: h' = ReLU(W x + b + U h + c).

    Attributes:
        from_input: W and b.
        from_memory: U and c.
        hidden: size of h.
    """

    from_input: Linear
    from_memory: Linear
    hidden: int = eqx.field(static=True)

    def __init__(self, inputs: int, hidden: int, *, key: PRNGKeyArray):
        keys = jax.random.split(key)
        self.from_input = Linear(inputs, hidden, key=keys[0])
        self.from_memory = Linear(hidden, hidden, key=keys[1])
        self.hidden = hidden

    def initial(self) -> Float[Array, "hidden"]:
        """Return h = 0."""
        return jnp.zeros(self.hidden)

    def __call__(
        self, memory: Float[Array, "hidden"], x: Float[Array, "inputs"]
    ) -> tuple[Float[Array, "hidden"], Float[Array, "hidden"]]:
        """Take one step."""
        h = jax.nn.relu(self.from_input(x) + self.from_memory(memory))
        return h, h


class LSTMCell(AbstractCell):
    """Long short-term memory; the memory is (h, c), the output h.

    (i, g, f, o) = W [x, h] + b,   c' = σ(f + 1) c + σ(i) tanh g,   h' = σ(o) tanh c'.

    Attributes:
        gates: W and b.
        hidden: size of h and of c.
    """

    gates: Linear
    hidden: int = eqx.field(static=True)

    def __init__(self, inputs: int, hidden: int, *, key: PRNGKeyArray):
        self.gates = Linear(inputs + hidden, 4 * hidden, key=key)
        self.hidden = hidden

    def initial(self) -> tuple[Float[Array, "hidden"], Float[Array, "hidden"]]:
        """Return h = 0 and c = 0."""
        return jnp.zeros(self.hidden), jnp.zeros(self.hidden)

    def __call__(
        self, memory: tuple[Float[Array, "hidden"], Float[Array, "hidden"]], x: Float[Array, "inputs"]
    ) -> tuple[tuple[Float[Array, "hidden"], Float[Array, "hidden"]], Float[Array, "hidden"]]:
        """Take one step."""
        h, c = memory
        i, g, f, o = jnp.split(self.gates(jnp.concatenate([x, h])), 4)
        c = jax.nn.sigmoid(f + 1.0) * c + jax.nn.sigmoid(i) * jnp.tanh(g)
        h = jax.nn.sigmoid(o) * jnp.tanh(c)
        return (h, c), h


class GRUCell(AbstractCell):
    """Gated recurrent unit; the output is the memory h.

    z = σ(W₁ x + U₁ h + b₁),   r = σ(W₂ x + U₂ h + b₂),   a = tanh(W₃ x + U₃ (r h) + b₃),   h' = (1 − z) h + z a.

    Attributes:
        from_input: (W₁ᵀ, W₂ᵀ, W₃ᵀ), side by side.
        from_memory: (U₁ᵀ, U₂ᵀ, U₃ᵀ), side by side.
        bias: (b₁, b₂, b₃).
        hidden: size of h.
    """

    from_input: Float[Array, "inputs gates"]
    from_memory: Float[Array, "hidden gates"]
    bias: Float[Array, "gates"]
    hidden: int = eqx.field(static=True)

    def __init__(self, inputs: int, hidden: int, *, key: PRNGKeyArray):
        keys = jax.random.split(key)
        # Haiku's variance scaling makes up for the cut of the normal distribution, other than its dense layers.
        self.from_input = lecun_normal(keys[0], (inputs, 3 * hidden))
        self.from_memory = lecun_normal(keys[1], (hidden, 3 * hidden))
        self.bias = jnp.zeros(3 * hidden)
        self.hidden = hidden

    def initial(self) -> Float[Array, "hidden"]:
        """Return h = 0."""
        return jnp.zeros(self.hidden)

    def __call__(
        self, memory: Float[Array, "hidden"], x: Float[Array, "inputs"]
    ) -> tuple[Float[Array, "hidden"], Float[Array, "hidden"]]:
        """Take one step."""
        gates = jnp.matmul(x, self.from_input, precision="highest") + self.bias
        by_gate, by_candidate = jnp.split(self.from_memory, [2 * self.hidden], axis=1)
        z, r = jnp.split(jax.nn.sigmoid(gates[: 2 * self.hidden] + jnp.matmul(memory, by_gate, precision="highest")), 2)
        candidate = jnp.tanh(gates[2 * self.hidden :] + jnp.matmul(r * memory, by_candidate, precision="highest"))
        h = (1 - z) * memory + z * candidate
        return h, h


KINDS: dict[str, Callable[..., AbstractCell]] = {"vanilla": VanillaCell, "lstm": LSTMCell, "gru": GRUCell}
"""Cells by the name that settings give them."""


class Stack(eqx.Module):
    """Cells one after the other, with swish between them.

    Attributes:
        cells: in the order of application.
    """

    cells: tuple[AbstractCell, ...]

    def __init__(self, kind: str, inputs: int, sizes: tuple[int, ...], *, key: PRNGKeyArray):
        """Build cells of one kind.

        Args:
            kind: a key of `KINDS`.
            inputs: size of what the first cell takes.
            sizes: units of each cell.
            key: of the random kernels.
        """
        keys = jax.random.split(key, len(sizes))
        cell, before = KINDS[kind], (inputs, *sizes[:-1])
        self.cells = tuple(cell(a, b, key=k) for a, b, k in zip(before, sizes, keys, strict=True))

    def initial(self) -> tuple[Any, ...]:
        """Return the memories before the first step."""
        return tuple(cell.initial() for cell in self.cells)

    def __call__(self, memories: tuple[Any, ...], x: Float[Array, "inputs"]) -> tuple[tuple[Any, ...], Array]:
        """Take one step; return the memories after it and the output of the last cell."""
        after = []
        for k, (cell, memory) in enumerate(zip(self.cells, memories, strict=True)):
            memory, x = cell(memory, jax.nn.swish(x) if k else x)
            after.append(memory)
        return tuple(after), x
