"""What models without mechanics share: the latent vector is the state, and one network moves it."""

from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics import AbstractField, AbstractIntegrator, FirstOrderDynamics, State, SwishMLP
from keycld.models.latent.model import AbstractLatentModel, vision
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from keycld.models.latent.config import LatentConfig


class NetworkField(AbstractField):
    """F(s, u) by a `SwishMLP`, which takes the inputs next to the state.

    Attributes:
        network: [D + l] → [D].
    """

    network: SwishMLP

    def derivative(
        self, coordinates: Float[Array, "D"], u: Float[Array, "l"], parameters: dict[str, Any] | None = None
    ) -> Float[Array, "D"]:
        """Return F(s, u); `parameters` are not used."""
        return self.network(jnp.concatenate([coordinates, u]))


class AbstractUnstructuredModel(AbstractLatentModel):
    """A model that moves its latent vector as a whole, by a `NetworkField`, and renders the whole of it."""

    def state(self, latent: Float[Array, "D"]) -> State:
        """Return the latent vector as the state."""
        return State(latent, {})

    def visible(self, state: State) -> Float[Array, "D"]:
        """Return the whole state."""
        return state.coordinates


def parts(config: "LatentConfig", scene: Scene, integrator: AbstractIntegrator, key: PRNGKeyArray) -> dict[str, Any]:
    """Build what such a model consists of, with random weights, by the names of its fields."""
    keys = jax.random.split(key, 3)
    latent = config.latent
    network = SwishMLP(latent + scene.inputs, latent, config.hidden, config.depth, key=keys[0])
    encoder, decoder = vision(config, scene, latent, keys[1:])
    return {
        "encoder": encoder,
        "dynamics": FirstOrderDynamics(NetworkField(network), integrator),
        "decoder": decoder,
        "given": config.given,
        "anchored": config.anchor,
        "interval": config.interval,
        "inputs": scene.inputs,
    }
