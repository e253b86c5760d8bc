"""A pendulum: the toy physics sets `toy/pendulum`, `_colors` and `_colors_friction`."""

import abc
from collections.abc import Mapping
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld.systems.distributions import annulus
from keycld.systems.hamiltonian.base import AbstractHamiltonianSystem, disc_radius
from keycld.systems.registry import register
from keycld.systems.sampled import COUNTS_WITH_LONG, RELEASED

if TYPE_CHECKING:
    import keycld.mechanics

_RADII = (1.3, 2.3)
_VARIED = {"m": (0.5, 1.5), "g": (3.0, 4.0), "l": (0.5, 1.0)}


class AbstractToyPendulum(AbstractHamiltonianSystem, abc.ABC):
    """H = m g l (1 − cos q) + p² / (2 m l²) with friction λ: the physics that the three sets share."""

    state_names = ("q", "p")
    units = ("rad", "1")

    def hamiltonian(
        self, q: Float[Array, "1"], p: Float[Array, "1"], parameters: Mapping[str, Array]
    ) -> Float[Array, ""]:
        """Compute H = m g l (1 − cos q) + p² / (2 m l²), q = 0 hanging."""
        m, g, length = (parameters[name] for name in ("m", "g", "l"))
        return m * g * length * (1 - jnp.cos(q[0])) + p[0] ** 2 / (2 * m * length**2)

    def masses(self, parameters: Mapping[str, Array]) -> Float[Array, "1"]:
        """Return m, the mass of the one disc."""
        return parameters["m"][None]

    def centres(self, q: Float[Array, "1"], parameters: Mapping[str, Array]) -> Float[Array, "1 2"]:
        """Return (l sin q, −l cos q)."""
        return parameters["l"] * jnp.stack([jnp.sin(q), -jnp.cos(q)], axis=-1)

    def initial_state(
        self, random: np.random.RandomState, protocol: str
    ) -> tuple[Float[np.ndarray, "2"], dict[str, np.ndarray]]:
        """Sample (q, p) in the ring of radii 1.3 to 2.3.

        Released: uniform in radius without "+c", by area with it. Paper: by area always.
        """
        parameters = self.constants(random)
        point = annulus(random, _RADII, by_area=self.varied or protocol != RELEASED)
        return point, {**parameters, **self.look(random, 1, protocol, self.varied)}

    def relations(self) -> tuple["keycld.mechanics.AbstractRelation", ...]:
        """Return the constraint that the disc keeps its distance from the image centre."""
        from keycld.mechanics import DistanceToPoint

        return (DistanceToPoint("disc", (0.0, 0.0)),)


@register
class ToyPendulum(AbstractToyPendulum):
    """q̈ = −(g/l) sin q with m = 0.5, g = 3, l = 1: small swings take 3.63 (73 frames).

    One red disc, no rod. State: angle q from hanging (unwrapped), p = m l² q̇; H = m g l (1 − cos q) + p² / (2 m l²).
    Initial states lie on both sides of the separatrix H = 3, so it swings or turns over. Pictures are upside down: y
    grows downward. Source: "Which priors matter?" (arXiv 2111.05458), section 4.1 and table 2; released configuration
    PENDULUM.
    """

    name = "toy/pendulum"
    ranges = {"m": (0.5, 0.5), "g": (3.0, 3.0), "l": (1.0, 1.0)}
    half_width = 1.0 + disc_radius(0.5)
    hues = 1
    keypoints = ("disc",)
    counts = COUNTS_WITH_LONG


@register
class ToyPendulumColors(AbstractToyPendulum):
    """q̈ = −(g/l) sin q with m ~ U(0.5, 1.5), g ~ U(3, 4), l ~ U(0.5, 1).

    One disc of area m in one of six colours, around a pivot anywhere. State: angle q, p = m l² q̇. Source: "Which
    priors matter?", section 4.1 and table 3; released configuration PENDULUM_COLORS.
    """

    name = "toy/pendulum_colors"
    ranges = _VARIED
    half_width = 1.0 + disc_radius(1.5)
    varied = True
    keypoints = ("disc",)
    looks_differ = True
    hues = 6
    counts = COUNTS_WITH_LONG


@register
class ToyPendulumColorsFriction(AbstractToyPendulum):
    """q̈ = −(g/l) sin q − λ/(m l²) q̇ with m ~ U(0.5, 1.5), g ~ U(3, 4), l ~ U(0.5, 1), λ = 0.05.

    Pictures and initial states are those of `toy/pendulum_colors`; what turns over at first may end swinging. Source:
    "Which priors matter?", section 4.1; released configuration PENDULUM_COLORS_FRICTION.
    """

    name = "toy/pendulum_colors_friction"
    ranges = _VARIED
    half_width = 1.0 + disc_radius(1.5)
    varied = True
    keypoints = ("disc",)
    looks_differ = True
    friction = 0.05
    hues = 6
