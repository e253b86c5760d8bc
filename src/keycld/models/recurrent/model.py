"""AR: each picture follows from the one before it and from what recurrent cells remember of all earlier ones."""

from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics import State
from keycld.models.base import AbstractModel
from keycld.models.checks import check_inputs, check_size
from keycld.models.recurrent.cells import Stack
from keycld.models.scene import Scene
from keycld.vision import ImageDecoder, ImageEncoder

if TYPE_CHECKING:
    from keycld.models.recurrent.config import RecurrentConfig


class Memory(NamedTuple):
    """What evolves in an autoregressive model.

    Attributes:
        cells: memories of the recurrent cells after all frames before this one.
        picture: this frame: as it was given, or as it was predicted.
    """

    cells: tuple[Any, ...]
    picture: Float[Array, "H W 3"]


class AR(AbstractModel):
    """Autoregressive recurrent network of "Which priors matter?": no physics, no probability, forward only.

    One step encodes the picture of the state, passes the cells, and decodes the next picture. Given frames are fed one
    after the other; from the last of them on, the model is fed its own predictions. Inputs, where there are any, are
    appended to the encoded picture.

    Attributes:
        encoder: a picture → numbers.
        stack: recurrent cells.
        decoder: output of the last cell → the next picture.
        given: the least number of frames that a prediction starts from.
        inputs: l.
    """

    encoder: ImageEncoder
    stack: Stack
    decoder: ImageDecoder
    given: int = eqx.field(static=True)
    inputs: int = eqx.field(static=True)

    @property
    def context(self) -> int:
        """As many frames as the settings give."""
        return self.given

    def anchor(self, n: int) -> int:
        """Return the last given frame."""
        return n - 1

    def infer(self, frames: Float[Array, "n H W 3"], dt: Float[Array, ""], u: Float[Array, "..."]) -> State:
        """Feed all frames but the last one, which becomes the picture of the state; dt is not used.

        Raises:
            KeycldError: frames of another size, or another number of inputs, than the model knows.
        """
        check_inputs(u, self.inputs)
        check_size(frames[0], self.encoder.size)
        codes = jax.vmap(self.encoder)(frames[:-1])
        cells, _ = self.pass_on(self.stack.initial(), codes, u if u.ndim == 1 else u[: codes.shape[0]])
        return State(Memory(cells, frames[-1]), {})

    def rollout(self, state: State, dt: Float[Array, ""], u: Float[Array, "..."], steps: int) -> State:
        """Predict pictures, each fed back; dt is not used.

        A compiled roll-out cannot look at dt, so nothing refuses a negative one; `predict` never passes it.
        """

        def step(memory: Memory, u: Array) -> tuple[Memory, Memory]:
            cells, output = self.stack(memory.cells, jnp.concatenate([self.encoder(memory.picture), u]))
            memory = Memory(cells, self.decoder(output))
            return memory, memory

        first = state.coordinates
        _, rest = jax.lax.scan(step, first, held(u, steps))
        return State(jax.tree.map(lambda here, there: jnp.concatenate([here[None], there]), first, rest), {})

    def pass_on(
        self, cells: tuple[Any, ...], codes: Float[Array, "steps D"], u: Float[Array, "..."]
    ) -> tuple[tuple[Any, ...], Float[Array, "steps D"]]:
        """Feed encoded pictures to the cells.

        Args:
            cells: the memories before the first of them.
            codes: encoded consecutive pictures.
            u: `[l]`, constant, or `[steps, l]`.

        Returns:
            the memories after the last picture, and the output of the last cell for each.
        """
        fed = jnp.concatenate([codes, held(u, codes.shape[0])], axis=-1)
        # A function around the module, because `scan` hashes what it is given.
        return jax.lax.scan(lambda cells, x: self.stack(cells, x), cells, fed)

    def render(self, state: State) -> Float[Array, "H W 3"]:
        """Return the picture of the state: at the anchor the given frame, later the predicted one."""
        return state.coordinates.picture


def held(u: Float[Array, "..."], steps: int) -> Float[Array, "steps l"]:
    """Return one input a step, of a constant one too."""
    return jnp.broadcast_to(u[None, :], (steps, u.shape[0])) if u.ndim == 1 else u


def build(config: "RecurrentConfig", scene: Scene, key: PRNGKeyArray) -> AR:
    """Build an AR with random weights."""
    keys = jax.random.split(key, 3)
    size, latent = (scene.height, scene.width), config.latent
    sizes = (*[config.hidden] * (config.layers - 1), latent)
    return AR(
        encoder=ImageEncoder(size, 3, latent, config.channels, key=keys[0]),
        stack=Stack(config.cell, latent + scene.inputs, sizes, key=keys[1]),
        decoder=ImageDecoder(size, latent, latent // 2, config.channels, taper=config.taper, key=keys[2]),
        given=config.given,
        inputs=scene.inputs,
    )
