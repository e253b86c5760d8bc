"""A mass on a spring: the toy physics sets `toy/mass_spring`, `_colors` and `_colors_friction`."""

import abc
import math
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

_AMPLITUDES = (0.1, 1.0)
_VARIED = {"k": (2.0, 2.0), "m": (0.2, 1.0)}


class AbstractMassSpring(AbstractHamiltonianSystem, abc.ABC):
    """H = k q² / 2 + p² / 2m with friction λ: the physics that the three sets share."""

    state_names = ("q", "p")
    units = ("1", "1")

    def hamiltonian(
        self, q: Float[Array, "1"], p: Float[Array, "1"], parameters: Mapping[str, Array]
    ) -> Float[Array, ""]:
        """Compute H = k q² / 2 + p² / 2m."""
        return parameters["k"] * q[0] ** 2 / 2 + p[0] ** 2 / (2 * parameters["m"])

    def motion(
        self, initial: Float[Array, "2"], parameters: Mapping[str, Array], times: Float[Array, "T"]
    ) -> Float[Array, "T 2"]:
        """Compute q = e^(−γt) (q₀ cos ωt + (q̇₀ + γ q₀)/ω sin ωt), γ = λ/2m, ω² = k/m − γ², p = m q̇."""
        k, m = parameters["k"], parameters["m"]
        rate = self.friction / (2 * m)
        omega = jnp.sqrt(k / m - rate**2)
        cosine, sine = initial[0], (initial[1] / m + rate * initial[0]) / omega
        c, s, decay = jnp.cos(omega * times), jnp.sin(omega * times), jnp.exp(-rate * times)
        q = decay * (cosine * c + sine * s)
        velocity = decay * omega * (sine * c - cosine * s) - rate * q
        return jnp.stack([q, m * velocity], axis=-1)

    def masses(self, parameters: Mapping[str, Array]) -> Float[Array, "1"]:
        """Return m, the mass of the one disc."""
        return parameters["m"][None]

    def centres(self, q: Float[Array, "1"], parameters: Mapping[str, Array]) -> Float[Array, "1 2"]:
        """Return (0, q), a point of the vertical axis."""
        return jnp.stack([jnp.zeros_like(q), q], axis=-1)

    def initial_state(
        self, random: np.random.RandomState, protocol: str
    ) -> tuple[Float[np.ndarray, "2"], dict[str, np.ndarray]]:
        """Sample (q, p/√(km)) in the ring of radii 0.1 to 1, so that the radius is the amplitude.

        Released: uniform in radius without "+c", by area with it; the random place of a "+c" set is one number in
        ± 0.4 half widths for x and y together, and x has a further U(0, 1). Paper: by area always; x and y are
        independent.
        """
        parameters = self.constants(random)
        point = annulus(random, _AMPLITUDES, by_area=self.varied or protocol != RELEASED)
        look = self.look(random, 1, protocol, self.varied)
        if self.varied and protocol == RELEASED:
            look["offset"][1] = look["offset"][0]
            look["offset"][0] += random.uniform(0.0, 1.0)
        scale = math.sqrt(parameters["k"] * parameters["m"])
        return point * np.array([1.0, scale]), {**parameters, **look}

    def relations(self) -> tuple["keycld.mechanics.AbstractRelation", ...]:
        """Return the constraint that the disc stays on the vertical axis."""
        from keycld.mechanics import OnLine

        return (OnLine("disc", direction=(0.0, 1.0)),)


@register
class MassSpring(AbstractMassSpring):
    """q̈ = −(k/m) q with k = 2 and m = 0.5: harmonic, period π (62.8 frames).

    One red disc moves up and down. State: q, p = m q̇; H = k q² / 2 + p² / 2m. The easiest of the suite: a still
    mean picture has a valid prediction time of 0. Source: "Which priors matter?" (arXiv 2111.05458), section 4.1 and
    table 2; released configuration MASS_SPRING.
    """

    name = "toy/mass_spring"
    ranges = {"k": (2.0, 2.0), "m": (0.5, 0.5)}
    half_width = _AMPLITUDES[1] + disc_radius(0.5)
    hues = 1
    keypoints = ("disc",)
    counts = COUNTS_WITH_LONG


@register
class MassSpringColors(AbstractMassSpring):
    """q̈ = −(k/m) q with k = 2 and m ~ U(0.2, 1): harmonic, 40 to 89 frames a period.

    One disc of area m in one of six colours, anywhere. State: q, p = m q̇. Source: "Which priors matter?",
    section 4.1 and table 3; released configuration MASS_SPRING_COLORS.
    """

    name = "toy/mass_spring_colors"
    ranges = _VARIED
    half_width = _AMPLITUDES[1] + disc_radius(1.0)
    varied = True
    keypoints = ("disc",)
    looks_differ = True
    hues = 6
    counts = COUNTS_WITH_LONG


@register
class MassSpringColorsFriction(AbstractMassSpring):
    """m q̈ = −k q − λ q̇ with k = 2, m ~ U(0.2, 1), λ = 0.05: a decaying oscillation.

    Pictures and initial states are those of `toy/mass_spring_colors`; the amplitude falls as e^(−λt/2m), by 27 to 80 %
    in 256 frames. Source: "Which priors matter?", section 4.1; released configuration MASS_SPRING_COLORS_FRICTION.
    """

    name = "toy/mass_spring_colors_friction"
    ranges = _VARIED
    half_width = _AMPLITUDES[1] + disc_radius(1.0)
    varied = True
    keypoints = ("disc",)
    looks_differ = True
    friction = 0.05
    hues = 6
