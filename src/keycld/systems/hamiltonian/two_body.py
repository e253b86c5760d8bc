"""Two bodies that attract each other: the toy physics sets `toy/two_body` and `toy/two_body_colors`."""

import abc
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld.systems.hamiltonian.base import AbstractHamiltonianSystem
from keycld.systems.hamiltonian.kepler import kepler
from keycld.systems.registry import register
from keycld.systems.sampled import PAPER

_COORDINATES = (0.5, 1.5)


class AbstractTwoBody(AbstractHamiltonianSystem, abc.ABC):
    """H = −g m₁ m₂ / |q₁ − q₂| + |p₁|²/2m₁ + |p₂|²/2m₂: the physics that the two sets share."""

    state_names = ("x_1", "y_1", "x_2", "y_2", "px_1", "py_1", "px_2", "py_2")
    units = ("1",) * 8

    def hamiltonian(
        self, q: Float[Array, "4"], p: Float[Array, "4"], parameters: Mapping[str, Array]
    ) -> Float[Array, ""]:
        """Compute H = −g m₁ m₂ / |q₁ − q₂| + |p₁|²/2m₁ + |p₂|²/2m₂."""
        m, gap = parameters["m"], q[:2] - q[2:]
        kinetic = jnp.sum(p[:2] ** 2) / (2 * m[0]) + jnp.sum(p[2:] ** 2) / (2 * m[1])
        return kinetic - parameters["g"] * m[0] * m[1] / jnp.sqrt(jnp.sum(gap**2))

    def motion(
        self, initial: Float[Array, "8"], parameters: Mapping[str, Array], times: Float[Array, "T"]
    ) -> Float[Array, "T 8"]:
        """Compute the even motion of the centre of mass, and Kepler's problem for the distance vector."""
        m = parameters["m"][:, None]
        total = jnp.sum(m)
        q, v = initial[:4].reshape(2, 2), initial[4:].reshape(2, 2) / m
        centre, drift = jnp.sum(m * q, axis=0) / total, jnp.sum(m * v, axis=0) / total

        def at(time):
            gap, speed = kepler(q[0] - q[1], v[0] - v[1], parameters["g"] * total, time)
            shares = jnp.stack([m[1] / total, -m[0] / total])
            positions = (centre + drift * time)[None, :] + shares * gap[None, :]
            momenta = m * (drift[None, :] + shares * speed[None, :])
            return jnp.concatenate([positions.reshape(-1), momenta.reshape(-1)])

        return jax.vmap(at)(times)

    def masses(self, parameters: Mapping[str, Array]) -> Float[Array, "2"]:
        """Return (m₁, m₂)."""
        return parameters["m"]

    def centres(self, q: Float[Array, "4"], parameters: Mapping[str, Array]) -> Float[Array, "2 2"]:
        """Return the positions of the bodies; the first lies on top."""
        return q.reshape(2, 2)

    def initial_state(
        self, random: np.random.RandomState, protocol: str
    ) -> tuple[Float[np.ndarray, "8"], dict[str, np.ndarray]]:
        """Sample bodies at ±(a, b), a and b ~ U(0.5, 1.5), momenta ±(b, −a) / (2 ρ^1.5), ρ² = a² + b².

        With masses and g of 1 the orbit is a circle, with others a conic. Paper: "+c" has random places too.
        """
        g = random.uniform(*self.ranges["g"])
        parameters = {"m": random.uniform(*self.ranges["m"], size=2), "g": np.array(g)}
        a, b = random.uniform(*_COORDINATES, size=2)
        p = np.array([b, -a]) / (2 * np.hypot(a, b) ** 1.5)
        look = self.look(random, 2, protocol, self.varied and protocol == PAPER)
        return np.array([a, b, -a, -b, *p, *-p]), {**parameters, **look}

    def accepts(self, state: Float[np.ndarray, "N T d"], parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return which trajectories stay within the canvas, before a random place is added."""
        return np.all(np.abs(state[:, :, :4]) <= self.half_width, axis=(1, 2))


@register
class TwoBody(AbstractTwoBody):
    """q̈₁ = −g m₂ (q₁ − q₂) / |q₁ − q₂|³ and its counterpart, with m₁ = m₂ = g = 1: circular orbits only.

    A red and a cyan disc, in a random order, on one circle of radius 0.7 to 2.1 around the image centre; a turn takes
    149 to 776 frames. State: both positions (x₁, y₁, x₂, y₂), both momenta. Source: "Which priors matter?" (arXiv
    2111.05458), section 4.1 and table 2; released configuration TWO_BODY, which adds no noise to the circular
    velocities.
    """

    name = "toy/two_body"
    ranges = {"m": (1.0, 1.0), "g": (1.0, 1.0)}
    half_width = 2.75
    hues = 2
    # The bodies are alike, so a keypoint may follow a colour: `looks_differ` is not needed.
    keypoints = ("first", "second")


@register
class TwoBodyColors(AbstractTwoBody):
    """q̈₁ = −g m₂ (q₁ − q₂) / |q₁ − q₂|³ and its counterpart, m₁ and m₂ ~ U(0.5, 1.5), g ~ U(0.5, 1.5).

    Two discs of area m and of different colours out of six. Ellipses, also narrow ones, and hyperbolas; about a fifth
    of the samples leave the square of ±5 and are sampled again. State: both positions, both momenta. In the released
    configuration nothing shifts the picture; `--protocol priors-paper` does. Source: "Which priors matter?",
    section 4.1 and table 3 (its "h" is g); released configuration TWO_BODY_COLORS.
    """

    name = "toy/two_body_colors"
    ranges = {"m": (0.5, 1.5), "g": (0.5, 1.5)}
    varied = True
    keypoints = ("first", "second")
    looks_differ = True
    half_width = 5.0
    hues = 6
