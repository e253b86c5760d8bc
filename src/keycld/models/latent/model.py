"""The chassis: frames → latent vector → dynamics → frames. A model adds what the latent vector means."""

from abc import abstractmethod
from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.mechanics import FirstOrderDynamics, HamiltonianDynamics, MechanicalDynamics, State
from keycld.models.base import AbstractModel, Gaussian, HasPosterior
from keycld.models.checks import check_inputs, check_size
from keycld.models.scene import Scene
from keycld.vision import ImageDecoder, ImageEncoder, MapEncoder

if TYPE_CHECKING:
    from keycld.models.latent.config import LatentConfig


class AbstractLatentModel(AbstractModel, HasPosterior):
    """A variational autoencoder around latent dynamics ("Which priors matter?", section 3).

    A few frames, stacked as channels, become a normal distribution of the latent vector z. Training samples z,
    everything else takes its mean. z is a state of the dynamics, which move it frame by frame; each state is rendered.

    Attributes:
        encoder: `given` stacked frames → mean and log deviation of z.
        dynamics: carry the state from frame to frame.
        decoder: what a picture shows of the state → the picture.
        given: how many frames the encoder sees.
        anchored: which of them the state belongs to.
        interval: time between two frames in the dynamics' own unit; of the data's dt only the sign counts.
        inputs: l.
    """

    encoder: ImageEncoder | MapEncoder
    dynamics: HamiltonianDynamics | FirstOrderDynamics | MechanicalDynamics
    decoder: ImageDecoder
    given: int = eqx.field(static=True)
    anchored: int = eqx.field(static=True)
    interval: float = eqx.field(static=True)
    inputs: int = eqx.field(static=True)

    @abstractmethod
    def state(self, latent: Float[Array, "D"]) -> State:
        """Return the state that a latent vector is."""

    @abstractmethod
    def visible(self, state: State) -> Float[Array, "m"]:
        """Return what a picture shows of a state."""

    @property
    def context(self) -> int:
        """As many frames as the encoder sees."""
        return self.given

    def anchor(self, n: int) -> int:
        """Return the frame that the state belongs to; frames beyond the first `context` are not used."""
        return self.anchored

    def posterior(self, frames: Float[Array, "n H W 3"]) -> Gaussian:
        """Return the distribution of the latent vector given the first `context` frames.

        Raises:
            KeycldError: frames of another size than the model renders.
        """
        check_size(frames[0], self.encoder.size)
        stacked = jnp.concatenate(list(frames[: self.given]), axis=-1)
        mean, log_deviation = jnp.split(self.encoder(stacked), 2)
        return Gaussian(mean, jnp.exp(log_deviation))

    def infer(self, frames: Float[Array, "n H W 3"], dt: Float[Array, ""], u: Float[Array, "..."]) -> State:
        """Return the state of the posterior's mean; dt and u are not used.

        Raises:
            KeycldError: frames of another size, or another number of inputs, than the model knows.
        """
        check_inputs(u, self.inputs)
        return self.state(self.posterior(frames).mean)

    def rollout(self, state: State, dt: Float[Array, ""], u: Float[Array, "..."], steps: int) -> State:
        """Integrate the dynamics, one `interval` a frame; backward for negative dt."""
        return State(self.dynamics.rollout(state, u, jnp.sign(dt) * self.interval, steps), {})

    def render(self, state: State) -> Float[Array, "H W 3"]:
        """Decode what is visible of the state."""
        return self.decoder(self.visible(state))


def vision(config: "LatentConfig", scene: Scene, visible: int, keys: Array) -> tuple[ImageEncoder, ImageDecoder]:
    """Build an encoder to the distribution of the latent vector, and a decoder of `visible` numbers, from two keys."""
    size, channels = (scene.height, scene.width), config.channels
    encoder = ImageEncoder(size, 3 * config.given, 2 * config.latent, channels, key=keys[0])
    decoder = ImageDecoder(size, visible, config.latent // 2, channels, taper=config.taper, key=keys[1])
    return encoder, decoder
