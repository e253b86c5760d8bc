"""What the toy physics sets share: discs in the plane that follow a Hamiltonian, with or without friction."""

import abc
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld.systems.discs import NAME, VERSION, hue_colours, soft_discs
from keycld.systems.distributions import distinct
from keycld.systems.initial_values import AbstractInitialValueSystem
from keycld.systems.rendered import map_states
from keycld.systems.sampled import PAPER, PUBLISHED_COUNTS, RELEASED
from keycld.systems.solving import solve

if TYPE_CHECKING:
    import keycld.mechanics

# A canvas with room for random places is larger by this part of its half width.
_ROOM = 0.4


class AbstractHamiltonianSystem(AbstractInitialValueSystem):
    """dq/dt = ∂H/∂p, dp/dt = −∂H/∂q − λ ∂H/∂p, so that dH/dt = −λ |∂H/∂p|².

    The state holds all positions, then all momenta, in units of the model. Every moving point is shown as a soft disc
    whose area is its mass. The y axis of the pictures points down, as in the released renderer. Source: "Which priors
    matter?" (arXiv 2111.05458), section 4.1 and appendix A.1.1.

    Attributes:
        ranges: least and largest value of each parameter, sampled uniformly and independently.
        varied: the "+c" sets, with random parameters, colours and places.
        friction: λ.
        hues: how many colours there are to choose from.
        half_width: of the square that the centres of the discs never leave, world units.
    """

    dt: ClassVar[float] = 0.05
    protocols: ClassVar[tuple[str, ...]] = (RELEASED, PAPER)
    renderer: ClassVar[str] = NAME
    renderer_version: ClassVar[int] = VERSION
    counts = PUBLISHED_COUNTS
    ranges: ClassVar[Mapping[str, tuple[float, float]]]
    varied: ClassVar[bool] = False
    friction: ClassVar[float] = 0.0
    hues: ClassVar[int]
    half_width: ClassVar[float]

    @abc.abstractmethod
    def hamiltonian(
        self, q: Float[Array, "n"], p: Float[Array, "n"], parameters: Mapping[str, Array]
    ) -> Float[Array, ""]:
        """Compute H(q, p)."""

    @abc.abstractmethod
    def masses(self, parameters: Mapping[str, Array]) -> Float[Array, "discs"]:
        """Return the masses of the points that are shown; an area in the picture each."""

    @abc.abstractmethod
    def centres(self, q: Float[Array, "n"], parameters: Mapping[str, Array]) -> Float[Array, "discs 2"]:
        """Return the centres of the discs before a random place is added; world units."""

    def derivative(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, "d"]:
        """Compute Hamilton's equations with friction (the suite's own stored derivatives leave friction out)."""
        q, p = jnp.split(state, 2)
        slope_q, slope_p = jax.grad(lambda q, p: self.hamiltonian(q, p, parameters), (0, 1))(q, p)
        return jnp.concatenate([slope_p, -slope_q - self.friction * slope_p])

    def motion(
        self, initial: Float[Array, "d"], parameters: Mapping[str, Array], times: Float[Array, "T"]
    ) -> Float[Array, "T d"]:
        """Integrate Hamilton's equations; systems with a closed form override this."""
        return solve(lambda state: self.derivative(state, parameters), initial, times)

    def conserved(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, ""]:
        """Compute the energy, H."""
        q, p = jnp.split(state, 2)
        return self.hamiltonian(q, p, parameters)

    def visible(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, "m"]:
        """Return the centres of the discs, one after another, in their random place."""
        centres = self.centres(jnp.split(state, 2)[0], parameters)
        return (centres + parameters["offset"][None, :]).reshape(-1)

    def render(self, visible: Float[Array, "m"], parameters: Mapping[str, Array]) -> Float[Array, "size size 3"]:
        """Render soft discs of area m and hue `color_index` / `hues`."""
        radii = jnp.sqrt(self.masses(parameters) / math.pi)
        colours = jnp.asarray(hue_colours(self.hues), visible.dtype)[parameters["color_index"]]
        canvas = parameters["canvas"] * jnp.array([-1.0, 1.0], visible.dtype)
        return soft_discs(visible.reshape(-1, 2), radii, colours, canvas, self.size)

    @property
    def parameters_differ(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Whether this is a "+c" set."""
        return self.varied

    @property
    def constraints(self) -> "keycld.mechanics.Constraints | None":
        """The `relations` between the keypoints, around the place of the trajectory."""
        from keycld.mechanics import Constraints

        return None if not self.keypoints else Constraints(keypoints=self.keypoints, items=self.relations())

    def relations(self) -> tuple["keycld.mechanics.AbstractRelation", ...]:
        """Return the constraints on the keypoints; none by default."""
        return ()

    def landmarks(self, state: np.ndarray) -> np.ndarray:
        """Return the centres of the discs `[..., K, 2]`; K is 0 for the "+c" sets.

        The state does not tell the random places of those. The y axis of the pictures points down, that of the image
        plane up.
        """
        if self.varied or not self.keypoints:
            return super().landmarks(state)
        states = np.asarray(state, np.float64).reshape(-1, 1, state.shape[-1])
        constants = {name: np.full(len(states), low) for name, (low, _) in self.ranges.items()}
        visible = map_states(self.visible, states, {**constants, "offset": np.zeros((len(states), 2))})
        return visible.reshape(*state.shape[:-1], -1, 2) / self.half_width * np.array([1.0, -1.0])

    def constants(self, random: np.random.RandomState) -> dict[str, np.ndarray]:
        """Sample each parameter, uniform in its range."""
        return {name: np.array(random.uniform(*limits)) for name, limits in self.ranges.items()}

    def look(self, random: np.random.RandomState, discs: int, protocol: str, placed: bool) -> dict[str, np.ndarray]:
        """Sample colours, place and canvas of a trajectory.

        Several discs never have the same colour. The paper's sets without "+c" have fixed colours, the
        released ones sample them too. `placed`: each of x and y is shifted by up to ± 0.4 half widths and the
        canvas is larger by as much.
        """
        any_colour = self.varied or protocol == RELEASED
        colours = distinct(random, discs, self.hues) if any_colour else np.arange(discs)
        reach = _ROOM * self.half_width if placed else 0.0
        return {
            "color_index": colours,
            "offset": random.uniform(-reach, reach, size=2),
            "canvas": np.array(self.half_width + reach),
        }


def disc_radius(mass: float) -> float:
    """Return the radius of a disc whose area is its mass."""
    return math.sqrt(mass / math.pi)
