"""Lennard-Jones particles in two dimensions: the molecular dynamics sets `md/lj_4` and `md/lj_16`."""

import abc
import math
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld.systems.discs import NAME, VERSION, hue_colours, soft_discs
from keycld.systems.molecular import simulation
from keycld.systems.registry import register
from keycld.systems.rendered import AbstractRenderedSystem
from keycld.systems.sampled import PAPER, Recording

_LENGTHS = {"default": simulation.Lengths(1e3, 1e3, 2.5e3), "full": simulation.Lengths(1e4, 1e4, 2.5e4)}
# Windows that are stored of each simulation: one in 35.7 τ in both sizes, so that they are nearly independent.
WINDOWS = {"default": 70, "full": 700}
# Simulations side by side: vector registers are full, and all of a step's arrays stay in the fastest cache.
_TOGETHER = 8


def _names(particles: int) -> tuple[str, ...]:
    axes = (("x", "y"), ("vx", "vy"))
    return tuple(f"{axis}_{i}" for pair in axes for i in range(1, particles + 1) for axis in pair)


class AbstractLennardJones(AbstractRenderedSystem, abc.ABC):
    """ẍᵢ = −∂U/∂xᵢ with U = Σ u(r), u = 4 (r⁻¹² − r⁻⁶) for r < L/2 and 0 beyond, nearest images.

    Reduced units (σ, ε, m and τ are 1). State: positions, then velocities. Trajectory n is window n mod W of simulation
    n // W, W = 70 (default size) or 700 (full). Source: "Which priors matter?" (arXiv 2111.05458), section 4.3 and
    appendix A.1.3.

    Attributes:
        particles: N.
        density: ρ*.
        temperature: T*.
        radius: of the discs; the paper says "adjusted to fit the canvas well".
    """

    dt: ClassVar[float] = simulation.STEPS_A_FRAME * simulation.TIME_STEP
    protocols: ClassVar[tuple[str, ...]] = (PAPER,)
    renderer: ClassVar[str] = NAME
    renderer_version: ClassVar[int] = VERSION
    counts = {"default": {"train": 5_600, "test": 1_400}, "full": {"train": 50_000, "test": 20_000}}
    particles: ClassVar[int]
    density: ClassVar[float]
    temperature: ClassVar[float]
    radius: ClassVar[float]

    @property
    def box(self) -> float:
        """L, the side of the periodic square."""
        return math.sqrt(self.particles / self.density)

    def group(self, frames: int, size: str, images: bool) -> int:
        """Return the number of windows of eight simulations."""
        return _TOGETHER * WINDOWS[size]

    def related(self, size: str) -> int:
        """Return the number of windows of one simulation."""
        return WINDOWS[size]

    def record(self, numbers: range, frames: int, protocol: str, size: str) -> Recording:
        """Run the simulations that these numbers belong to, from their beginning to their end."""
        windows = WINDOWS[size]
        simulations = np.arange(numbers[0] // windows, numbers[-1] // windows + 1)
        with jax.enable_x64(True):
            moved = simulation.simulate(
                simulations, self.particles, self.density, self.temperature, _LENGTHS[size], windows, frames
            )
        first = numbers[0] - simulations[0] * windows
        state = moved.reshape(-1, *moved.shape[2:])[first : first + len(numbers)]
        number = np.array(numbers)
        parameters = {"seed": number, "simulation": number // windows, "window": number % windows}
        return Recording(self.dt * np.arange(frames), state, parameters)

    def _paired(self, state: Float[Array, "d"]) -> tuple[Float[Array, "2 N 1"], Float[Array, "2 N 1"]]:
        x, v = (a.reshape(-1, 2).T[:, :, None] for a in jnp.split(state, 2))
        return x, v

    def derivative(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, "d"]:
        """Return velocities and forces."""
        x, _ = self._paired(state)
        return jnp.concatenate([jnp.split(state, 2)[1], simulation.forces(x, self.box)[:, :, 0].T.reshape(-1)])

    def conserved(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, ""]:
        """Compute kinetic energy + Σ (u(r) − u(L/2)), which the truncated forces keep."""
        return simulation.shifted_energy(*self._paired(state), self.box)[0]

    def visible(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, "m"]:
        """Return the positions of the particles."""
        return jnp.split(state, 2)[0]

    def render(self, visible: Float[Array, "m"], parameters: Mapping[str, Array]) -> Float[Array, "size size 3"]:
        """Render discs of hue k/N, particle 0 on top, cut at the border: periodic images are not shown."""
        canvas = self.box / 2 * jnp.array([-1.0, 1.0], visible.dtype)
        radii = jnp.full(self.particles, self.radius, visible.dtype)
        colours = jnp.asarray(hue_colours(self.particles), visible.dtype)
        return soft_discs(visible.reshape(-1, 2), radii, colours, canvas, self.size)


@register
class LennardJones4(AbstractLennardJones):
    """Four Lennard-Jones particles, T* = 1.0, ρ* = 0.04: a thin gas in a periodic square of side 10.

    ẍᵢ = −∂U/∂xᵢ, pair potential 4 (r⁻¹² − r⁻⁶) cut at r = 5 and not shifted; frames are 0.01 τ apart. Mostly straight
    flight, at times a collision. Four discs of radius 0.8 in red, yellow-green, cyan and violet. State: positions, then
    velocities, in reduced units. Source: "Which priors matter?" (arXiv 2111.05458), section 4.3 and appendix A.1.3. The
    radius is inferred from table 5: the error of a constant picture, 295, needs 0.8.
    """

    name = "md/lj_4"
    particles = 4
    density = 0.04
    temperature = 1.0
    radius = 0.8
    state_names = _names(4)
    units = ("1",) * 16


@register
class LennardJones16(AbstractLennardJones):
    """Sixteen Lennard-Jones particles, T* = 0.5, ρ* = 0.77: a liquid in a periodic square of side 4.56.

    ẍᵢ = −∂U/∂xᵢ, pair potential 4 (r⁻¹² − r⁻⁶) cut at r = 2.28 and not shifted; frames are 0.01 τ apart. Particles
    rattle in cages of neighbours; nearby trajectories part within a few τ. Sixteen discs of radius 0.3 in sixteen hues.
    State: positions, then velocities, in reduced units. Source: "Which priors matter?" (arXiv 2111.05458), section 4.3
    and appendix A.1.3. The radius is the released default and agrees with table 5.
    """

    name = "md/lj_16"
    particles = 16
    density = 0.77
    temperature = 0.5
    radius = 0.3
    state_names = _names(16)
    units = ("1",) * 64
