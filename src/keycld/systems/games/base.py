"""Two-player games that go round in circles: `games/matching_pennies` and `games/rock_paper_scissors`."""

import abc
import math
from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld.systems.initial_values import AbstractInitialValueSystem
from keycld.systems.registry import register
from keycld.systems.sampled import RELEASED
from keycld.systems.distributions import simplex
from keycld.systems.solving import solve
from keycld.systems.hamiltonian.base import counts_with_long

_TOLERANCE = 1e-12


class AbstractGame(AbstractInitialValueSystem, abc.ABC):
    """ẋᵢ = xᵢ ((A y)ᵢ − xᵀA y), ẏⱼ = yⱼ ((xᵀB)ⱼ − xᵀB y) with B = −A: replicator dynamics of a zero-sum game.

    Source: "Which priors matter?", eq. (4) and appendix A.1.2.

    Attributes:
        payoff: A, the row player's.
    """

    dt: ClassVar[float] = 0.1
    protocols: ClassVar[tuple[str, ...]] = (RELEASED,)
    renderer: ClassVar[str] = "joint strategy"
    renderer_version: ClassVar[int] = 1
    counts = counts_with_long()
    payoff: ClassVar[tuple[tuple[float, ...], ...]]

    def derivative(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, "d"]:
        """Eq. (4)."""
        x, y = jnp.split(state, 2)
        a = jnp.asarray(self.payoff, state.dtype)
        gains_x, gains_y = a @ y, -(x @ a)
        return jnp.concatenate([x * (gains_x - x @ gains_x), y * (gains_y - gains_y @ y)])

    def conserved(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, ""]:
        """Σ ln xᵢ + Σ ln yⱼ; so in every zero-sum game whose equilibrium is even."""
        return jnp.sum(jnp.log(state))

    def motion(
        self, start: Float[Array, "d"], parameters: Mapping[str, Array], times: Float[Array, "T"]
    ) -> Float[Array, "T d"]:
        """Integrated."""
        return solve(lambda state: self.derivative(state, parameters), start, times, _TOLERANCE)

    def start(
        self, random: np.random.RandomState, protocol: str
    ) -> tuple[Float[np.ndarray, "d"], dict[str, np.ndarray]]:
        """Both players' strategies, independent, each uniform on its simplex."""
        return np.concatenate([simplex(random, len(self.payoff)) for _ in range(2)]), {}

    def accepts(self, state: Float[np.ndarray, "N T d"], parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """All."""
        return np.ones(len(state), bool)

    def seen(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, "d"]:
        """Everything."""
        return state

    def draw(self, seen: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, "size size 3"]:
        """The matrix xᵢ yⱼ in grey, each entry a block of ⌈32/n⌉ pixels, cut to the upper left 32 × 32."""
        x, y = jnp.split(seen, 2)
        block = np.arange(self.size) // math.ceil(self.size / len(self.payoff))
        joint = x[block][:, None] * y[block][None, :]
        return jnp.broadcast_to(joint[:, :, None], (self.size, self.size, 3))


@register
class MatchingPennies(AbstractGame):
    """ȧ = 2a(1−a)(2b−1), ḃ = −2b(1−b)(2a−1) for the shares a and b of heads: closed orbits around (½, ½).

    Period 2π (63 frames) near the centre, longer outside; ln a(1−a) + ln b(1−b) is constant. State: both players'
    strategies (a, 1−a, b, 1−b). The picture shows the four joint probabilities as grey squares and holds the whole
    state. Source: "Which priors matter?" (arXiv 2111.05458), section 4.2, eq. (4) and appendix A.1.2.
    """

    name = "games/matching_pennies"
    state_names = ("x_1", "x_2", "y_1", "y_2")
    units = ("1",) * 4
    payoff = ((1.0, -1.0), (-1.0, 1.0))


@register
class RockPaperScissors(AbstractGame):
    """Replicator dynamics of rock, paper, scissors: orbits around (⅓, ⅓, ⅓), (⅓, ⅓, ⅓).

    Period 2π√3 (109 frames) near the centre; Σ ln xᵢ + Σ ln yⱼ is constant. State: both players' strategies. The
    picture shows the nine joint probabilities as grey blocks of 11, 11 and 10 pixels. Source: "Which priors matter?"
    (arXiv 2111.05458), section 4.2, eq. (4) and appendix A.1.2.
    """

    name = "games/rock_paper_scissors"
    state_names = ("x_1", "x_2", "x_3", "y_1", "y_2", "y_3")
    units = ("1",) * 6
    payoff = ((0.0, -1.0, 1.0), (1.0, 0.0, -1.0), (-1.0, 1.0, 0.0))
