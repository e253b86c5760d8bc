"""LGN: the latent vector is a point and a velocity of a Lagrangian in generalised coordinates."""

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics import (
    GeneralizedLagrangian,
    MechanicalDynamics,
    MLPInputMatrix,
    Motion,
    State,
    SwishEnergy,
    SwishMLP,
    solve_definite,
)
from keycld.models.base import HasEnergies, Reversible
from keycld.models.latent.integrators import latent_integrator
from keycld.models.latent.model import AbstractLatentModel, vision
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from keycld.models.latent.recipes.lgn import ReleasedLGN


class OffsetFactor(eqx.Module):
    """A factor [Uᵀ, √λ I] of the mass matrix M(q) = UᵀU + λI, with U upper triangular, by a `SwishMLP`.

    The network's m (m + 1) / 2 outputs fill the triangle row by row. No eigenvalue of M is below λ.

    Attributes:
        network: q [m] → [m (m + 1) / 2].
        offset: λ, positive.
    """

    network: SwishMLP
    offset: float = eqx.field(static=True)

    def __call__(self, q: Float[Array, "m"]) -> Float[Array, "m r"]:
        """Return the factor, [m, 2m]."""
        m = q.shape[0]
        upper = jnp.zeros((m, m), q.dtype).at[jnp.triu_indices(m)].set(self.network(q))
        return jnp.concatenate([upper.T, jnp.sqrt(self.offset) * jnp.eye(m, dtype=q.dtype)], axis=1)


class LGN(AbstractLatentModel, HasEnergies, Reversible):
    """Lagrangian Generative Network of "Which priors matter?".

    The first half of the latent vector is q, the second q̇; L = ½ q̇ᵀM(q)q̇ − V(q) with M = UᵀU + λI of two networks,
    and the Euler–Lagrange equations give q̈. A picture shows q. Inputs act as generalised forces g(q) u, which is our
    addition.
    """

    dynamics: MechanicalDynamics

    def state(self, latent: Float[Array, "D"]) -> State:
        """Return the state with q and q̇ from the halves of a latent vector."""
        return State(Motion(*jnp.split(latent, 2)), {})

    def visible(self, state: State) -> Float[Array, "m"]:
        """Return q."""
        return state.coordinates.x

    @property
    def law(self) -> GeneralizedLagrangian:
        """M, V and g."""
        assert isinstance(self.dynamics.law, GeneralizedLagrangian)
        return self.dynamics.law

    def kinetic_energy(self, state: State) -> Float[Array, ""]:
        """Return ½ q̇ᵀM(q)q̇."""
        return self.law.kinetic_energy(*state.coordinates)

    def potential_energy(self, state: State) -> Float[Array, ""]:
        """Return V(q)."""
        return self.law.potential_energy(state.coordinates.x)


def build(config: "ReleasedLGN", scene: Scene, key: PRNGKeyArray) -> LGN:
    """Build an LGN with random weights."""
    half = config.latent // 2
    keys = jax.random.split(key, 5)
    masses = SwishMLP(half, half * (half + 1) // 2, config.hidden, config.depth, key=keys[0])
    encoder, decoder = vision(config, scene, half, keys[3:])
    law = GeneralizedLagrangian(
        factor=OffsetFactor(masses, config.mass_offset),
        potential=SwishEnergy(half, config.hidden, config.depth, key=keys[1]),
        input_matrix=MLPInputMatrix(half, scene.inputs, config.hidden, key=keys[2]) if scene.inputs else None,
        solve=solve_definite,
    )
    return LGN(
        encoder=encoder,
        dynamics=MechanicalDynamics(law, latent_integrator(config.integrator)),
        decoder=decoder,
        given=config.given,
        anchored=config.anchor,
        interval=config.interval,
        inputs=scene.inputs,
    )
