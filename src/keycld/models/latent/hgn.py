"""HGN: the latent vector is a point of the phase space of a separable Hamiltonian."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics import (
    HamiltonianDynamics,
    MLPInputMatrix,
    PhasePoint,
    SeparableHamiltonian,
    State,
    SwishEnergy,
    integrator_named,
)
from keycld.models.base import HasEnergies, Reversible
from keycld.models.latent.model import AbstractLatentModel, vision
from keycld.models.scene import Scene
from keycld.vision import ImageDecoder, ImageEncoder, MapEncoder, MapEnergy, MapTransform

if TYPE_CHECKING:
    from keycld.models.latent.config import LatentConfig


class HGN(AbstractLatentModel, HasEnergies, Reversible):
    """Hamiltonian Generative Network, in the configuration HGN++ of "Which priors matter?".

    The first half of the latent vector is q, the second p; H = T(p) + V(q) of two networks; q̇ = ∇T(p),
    ṗ = −∇V(q) + g(q) u, by leapfrog (kick, drift, kick), one step a frame. A picture shows q. Without inputs there is
    no g; with inputs it is our addition, the paper has none.

    Attributes:
        transform: applied to the latent vector before it is split, in the original HGN; None: nothing is.
    """

    dynamics: HamiltonianDynamics
    transform: MapTransform | None = None

    def state(self, latent: Float[Array, "D"]) -> State:
        """Return the state with q and p from the halves of a latent vector."""
        return State(PhasePoint(*jnp.split(latent if self.transform is None else self.transform(latent), 2)), {})

    def visible(self, state: State) -> Float[Array, "m"]:
        """Return q."""
        return state.coordinates.q

    @property
    def hamiltonian(self) -> SeparableHamiltonian:
        """T, V and g."""
        assert isinstance(self.dynamics.hamiltonian, SeparableHamiltonian)
        return self.dynamics.hamiltonian

    def kinetic_energy(self, state: State) -> Float[Array, ""]:
        """Return T(p) − T(0): the network itself knows T up to a constant only."""
        p = state.coordinates.p
        return self.hamiltonian.kinetic(p) - self.hamiltonian.kinetic(jnp.zeros_like(p))

    def potential_energy(self, state: State) -> Float[Array, ""]:
        """Return V(q)."""
        return self.hamiltonian.potential(state.coordinates.q)


def build(config: "LatentConfig", scene: Scene, key: PRNGKeyArray) -> HGN:
    """Build an HGN++ with random weights."""
    half = config.latent // 2
    keys = jax.random.split(key, 5)
    kinetic, potential = (SwishEnergy(half, config.hidden, config.depth, key=k) for k in keys[:2])
    encoder, decoder = vision(config, scene, half, keys[3:])
    return _assembled(config, scene, (encoder, decoder, None), (kinetic, potential), half, keys[2])


def build_original(config: "LatentConfig", scene: Scene, key: PRNGKeyArray) -> HGN:
    """Build the original HGN with random weights: q and p are maps of 4×4 cells, `latent` / 2 numbers each."""
    keys = jax.random.split(key, 6)
    size, channels, half = (scene.height, scene.width), config.channels, config.latent // 2
    decoder = ImageDecoder(size, half, half, channels, dense=False, slope=0.2, key=keys[0])
    rows, columns = decoder.coarse
    encoder = MapEncoder(size, 3 * config.given, config.latent, channels, key=keys[1])
    transform = MapTransform(decoder.coarse, config.latent, channels, key=keys[2])
    kinetic, potential = (MapEnergy(decoder.coarse, half, channels, key=k) for k in keys[3:5])
    return _assembled(
        config, scene, (encoder, decoder, transform), (kinetic, potential), rows * columns * half, keys[5]
    )


def _assembled(
    config: "LatentConfig",
    scene: Scene,
    vision: tuple[ImageEncoder | MapEncoder, ImageDecoder, MapTransform | None],
    energies: tuple[Callable, Callable],
    dim: int,
    key: PRNGKeyArray,
) -> HGN:
    """Put encoder, decoder, transform and the energies T and V of `dim` numbers together."""
    encoder, decoder, transform = vision
    force = MLPInputMatrix(dim, scene.inputs, config.hidden, key=key) if scene.inputs else None
    hamiltonian = SeparableHamiltonian(kinetic=energies[0], potential=energies[1], input_matrix=force)
    return HGN(
        encoder=encoder,
        dynamics=HamiltonianDynamics(hamiltonian, integrator_named("leap_frog")),
        decoder=decoder,
        given=config.given,
        anchored=config.anchor,
        interval=config.interval,
        inputs=scene.inputs,
        transform=transform,
    )
