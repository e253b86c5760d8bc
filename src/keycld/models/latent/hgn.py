"""HGN: the latent vector is a point of the phase space of a separable Hamiltonian."""

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

if TYPE_CHECKING:
    from keycld.models.latent.config import LatentConfig


class HGN(AbstractLatentModel, HasEnergies, Reversible):
    """Hamiltonian Generative Network, in the configuration HGN++ of "Which priors matter?".

    The first half of the latent vector is q, the second p; H = T(p) + V(q) of two networks; q̇ = ∇T(p),
    ṗ = −∇V(q) + g(q) u, by leapfrog (kick, drift, kick), one step a frame. A picture shows q. Without inputs there is
    no g; with inputs it is our addition, the paper has none.
    """

    dynamics: HamiltonianDynamics

    def state(self, latent: Float[Array, "D"]) -> State:
        """Return the state with q and p from the halves of a latent vector."""
        return State(PhasePoint(*jnp.split(latent, 2)), {})

    def visible(self, state: State) -> Float[Array, "m"]:
        """Return q."""
        return state.coordinates.q

    @property
    def hamiltonian(self) -> SeparableHamiltonian:
        """T, V and g."""
        assert isinstance(self.dynamics.hamiltonian, SeparableHamiltonian)
        return self.dynamics.hamiltonian

    def kinetic_energy(self, state: State) -> Float[Array, ""]:
        """Return T(p)."""
        return self.hamiltonian.kinetic(state.coordinates.p)

    def potential_energy(self, state: State) -> Float[Array, ""]:
        """Return V(q)."""
        return self.hamiltonian.potential(state.coordinates.q)


def build(config: "LatentConfig", scene: Scene, key: PRNGKeyArray) -> HGN:
    """Build an HGN with random weights."""
    half = config.latent // 2
    keys = jax.random.split(key, 5)
    kinetic, potential = (SwishEnergy(half, config.hidden, config.depth, key=k) for k in keys[:2])
    force = MLPInputMatrix(half, scene.inputs, config.hidden, key=keys[2]) if scene.inputs else None
    hamiltonian = SeparableHamiltonian(kinetic=kinetic, potential=potential, input_matrix=force)
    size = (scene.height, scene.width)
    encoder, decoder = vision(size, config.given, config.latent, half, config.channels, keys[3:])
    return HGN(
        encoder=encoder,
        dynamics=HamiltonianDynamics(hamiltonian, integrator_named("leap_frog")),
        decoder=decoder,
        given=config.given,
        anchored=config.anchor,
        interval=config.interval,
        inputs=scene.inputs,
    )
