"""Two players of a zero-sum game who learn by replicator dynamics."""

import abc
import math
from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld.systems.distributions import simplex
from keycld.systems.initial_values import AbstractInitialValueSystem
from keycld.systems.sampled import COUNTS_WITH_LONG, RELEASED
from keycld.systems.solving import solve

_TOLERANCE = 1e-12


class AbstractGame(AbstractInitialValueSystem, abc.ABC):
    """ẋᵢ = xᵢ ((A y)ᵢ − xᵀA y), ẏⱼ = yⱼ ((xᵀB)ⱼ − xᵀB y) with B = −A: replicator dynamics of a zero-sum game.

    State: the row player's strategy x, then the column player's y; shares without unit, each strategy sums to 1.
    Source: "Which priors matter?" (arXiv 2111.05458), eq. (4) and appendix A.1.2.

    Attributes:
        payoff: A, the row player's.
    """

    dt: ClassVar[float] = 0.1
    protocols: ClassVar[tuple[str, ...]] = (RELEASED,)
    renderer: ClassVar[str] = "joint strategy"
    renderer_version: ClassVar[int] = 1
    counts = COUNTS_WITH_LONG
    payoff: ClassVar[tuple[tuple[float, ...], ...]]

    def derivative(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, "d"]:
        """Compute eq. (4)."""
        x, y = jnp.split(state, 2)
        a = jnp.asarray(self.payoff, state.dtype)
        gains_x, gains_y = a @ y, -(x @ a)
        return jnp.concatenate([x * (gains_x - x @ gains_x), y * (gains_y - gains_y @ y)])

    def conserved(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, ""]:
        """Compute Σ ln xᵢ + Σ ln yⱼ, constant in every zero-sum game whose equilibrium is even."""
        return jnp.sum(jnp.log(state))

    def motion(
        self, initial: Float[Array, "d"], parameters: Mapping[str, Array], times: Float[Array, "T"]
    ) -> Float[Array, "T d"]:
        """Integrate eq. (4)."""
        return solve(lambda state: self.derivative(state, parameters), initial, times, _TOLERANCE)

    def initial_state(
        self, random: np.random.RandomState, protocol: str
    ) -> tuple[Float[np.ndarray, "d"], dict[str, np.ndarray]]:
        """Sample the strategies of both players, independent, each uniform on its simplex."""
        return np.concatenate([simplex(random, len(self.payoff)) for _ in range(2)]), {}

    def visible(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, "d"]:
        """Return the whole state."""
        return state

    def render(self, visible: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, "size size 3"]:
        """Render the matrix xᵢ yⱼ in grey, each entry a block of ⌈32/n⌉ pixels, cut to the upper left 32 × 32."""
        x, y = jnp.split(visible, 2)
        block = np.arange(self.size) // math.ceil(self.size / len(self.payoff))
        joint = x[block][:, None] * y[block][None, :]
        return jnp.broadcast_to(joint[:, :, None], (self.size, self.size, 3))
