"""A double pendulum: the toy physics sets `toy/double_pendulum`, `_colors` and `_colors_friction`."""

import abc
from collections.abc import Mapping
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld.systems.distributions import annulus
from keycld.systems.hamiltonian.base import AbstractHamiltonianSystem, disc_radius
from keycld.systems.registry import register
from keycld.systems.sampled import RELEASED

if TYPE_CHECKING:
    import keycld.mechanics

_RADII = (1.3, 2.3)
_RADII_VARIED = (1.0, 2.5)
_VARIED = {"m_1": (0.4, 0.6), "m_2": (0.4, 0.6), "l_1": (0.75, 1.0), "l_2": (0.75, 1.0), "g": (2.5, 4.0)}


class AbstractDoublePendulum(AbstractHamiltonianSystem, abc.ABC):
    """Two points on two massless rods, with friction λ: the physics that the three sets share."""

    state_names = ("q_1", "q_2", "p_1", "p_2")
    units = ("rad", "rad", "1", "1")

    def hamiltonian(
        self, q: Float[Array, "2"], p: Float[Array, "2"], parameters: Mapping[str, Array]
    ) -> Float[Array, ""]:
        """Compute H of absolute angles from hanging and their momenta.

        H = (m₂l₂²p₁² + (m₁+m₂)l₁²p₂² − 2m₂l₁l₂p₁p₂ cos(q₁−q₂)) / (2m₂l₁²l₂²(m₁ + m₂ sin²(q₁−q₂)))
        − (m₁+m₂)gl₁ cos q₁ − m₂gl₂ cos q₂. (Table 2 of the paper squares the sum in the denominator by mistake.)
        """
        m1, m2, l1, l2, g = (parameters[name] for name in ("m_1", "m_2", "l_1", "l_2", "g"))
        gap, total = q[0] - q[1], m1 + m2
        cross = 2 * m2 * l1 * l2 * p[0] * p[1] * jnp.cos(gap)
        above = m2 * l2**2 * p[0] ** 2 + total * l1**2 * p[1] ** 2 - cross
        below = 2 * m2 * l1**2 * l2**2 * (m1 + m2 * jnp.sin(gap) ** 2)
        return above / below - total * g * l1 * jnp.cos(q[0]) - m2 * g * l2 * jnp.cos(q[1])

    def masses(self, parameters: Mapping[str, Array]) -> Float[Array, "2"]:
        """Return (m₁, m₂)."""
        return jnp.stack([parameters["m_1"], parameters["m_2"]])

    def centres(self, q: Float[Array, "2"], parameters: Mapping[str, Array]) -> Float[Array, "2 2"]:
        """Return the disc that hangs from the origin and lies on top, then the one that hangs from it."""
        lengths = jnp.stack([parameters["l_1"], parameters["l_2"]])
        links = lengths[:, None] * jnp.stack([jnp.sin(q), -jnp.cos(q)], axis=-1)
        return jnp.cumsum(links, axis=0)

    def initial_state(
        self, random: np.random.RandomState, protocol: str
    ) -> tuple[Float[np.ndarray, "4"], dict[str, np.ndarray]]:
        """Sample (q₁, p₁) and (q₂, p₂), each in a ring.

        Released: radii 1.3 to 2.3, uniform in radius; with "+c" 1 to 2.5, by area. Paper: 1.3 to 2.3, by area.
        """
        parameters = self.constants(random)
        radii = _RADII_VARIED if self.varied and protocol == RELEASED else _RADII
        by_area = self.varied or protocol != RELEASED
        points = np.stack([annulus(random, radii, by_area=by_area) for _ in range(2)], axis=1)
        return points.reshape(-1), {**parameters, **self.look(random, 2, protocol, self.varied)}

    def relations(self) -> tuple["keycld.mechanics.AbstractRelation", ...]:
        """Return fixed distances: image centre to inner disc to outer disc."""
        from keycld.mechanics import DistanceToPoint, FixedDistance

        return (DistanceToPoint("inner", (0.0, 0.0)), FixedDistance("inner", "outer"))


@register
class DoublePendulum(AbstractDoublePendulum):
    """Two points of mass 0.5 on two massless rods of length 1, g = 3: chaotic at these energies.

    A red and a cyan disc, in a random order, no rods; the inner one lies on top. State: absolute angles q₁, q₂ from
    hanging, momenta p₁, p₂. Nearby trajectories part by a factor e every few seconds: exact pictures for 256 frames
    need all digits of the initial state. Pictures are upside down: y grows downward. Source: "Which priors matter?"
    (arXiv 2111.05458), section 4.1 and table 2 (its denominator corrected); released configuration DOUBLE_PENDULUM.
    """

    name = "toy/double_pendulum"
    ranges = {"m_1": (0.5, 0.5), "m_2": (0.5, 0.5), "l_1": (1.0, 1.0), "l_2": (1.0, 1.0), "g": (3.0, 3.0)}
    half_width = 2.0 + disc_radius(0.5)
    hues = 2
    keypoints = ("inner", "outer")
    looks_differ = True


@register
class DoublePendulumColors(AbstractDoublePendulum):
    """Two points of mass U(0.4, 0.6) on two massless rods of length U(0.75, 1), g ~ U(2.5, 4).

    Two discs of different colours out of six, around a pivot anywhere. State: absolute angles q₁, q₂, momenta p₁, p₂.
    Source: "Which priors matter?", section 4.1 and table 3; released configuration DOUBLE_PENDULUM_COLORS.
    """

    name = "toy/double_pendulum_colors"
    ranges = _VARIED
    half_width = 2.0 + disc_radius(0.6)
    varied = True
    keypoints = ("inner", "outer")
    looks_differ = True
    hues = 6


@register
class DoublePendulumColorsFriction(AbstractDoublePendulum):
    """As `toy/double_pendulum_colors`, with dp/dt = −∂H/∂q − λ ∂H/∂p, λ = 0.05.

    The same initial states. The motion calms down: later frames are easier than early ones. Source: "Which priors
    matter?", section 4.1; released configuration DOUBLE_PENDULUM_COLORS_FRICTION.
    """

    name = "toy/double_pendulum_colors_friction"
    ranges = _VARIED
    half_width = 2.0 + disc_radius(0.6)
    varied = True
    keypoints = ("inner", "outer")
    looks_differ = True
    friction = 0.05
    hues = 6
