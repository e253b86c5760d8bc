"""Clips: a few frames of a trajectory, sampled on the device from uint8 pictures, stored or drawn on demand."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray, UInt8

from keycld._errors import KeycldError
from keycld.data.drawn import DrawnLater, drawn_later
from keycld.data.store import Trajectories


class Resident(eqx.Module):
    """Training trajectories on the device. The true state is never among them.

    - `image`: all frames, or what draws those that are asked for from stored states.
    - `u`: input, constant along a trajectory `[N, l]` or held from each frame to the next `[N, T, l]`.
    - `dt`: seconds between frames.
    - `keypoints`: keypoints found by a trained observer `[N, T, 2K]`, where a stage has cached them.
    """

    image: UInt8[Array, "N T H W 3"] | DrawnLater
    u: Float[Array, "N *T l"]
    dt: Float[Array, ""]
    cached: Float[Array, "N T dim"] | None = None


def resident(trajectories: Trajectories) -> Resident:
    """Training trajectories on the device: their pictures, or, where only states are stored, what draws clips.

    Raises:
        KeycldError: there are neither pictures nor a renderer for the states.
    """
    image = drawn_later(trajectories) if trajectories.image is None else jnp.asarray(trajectories.image)
    if image is None:
        raise KeycldError("these data hold neither pictures nor states that a renderer of ours draws: add '/image'.")
    return Resident(image, jnp.asarray(trajectories.input), jnp.asarray(trajectories.dt, jnp.float32))


class TrainingData:
    """Stub until branch data lands."""

    def __init__(self, data: Resident):
        self._data = data
        self.shape = data.image.shape

    def at(self, step: int) -> Resident:
        return self._data

    def until(self, step: int) -> int | None:
        return None


class Clip(eqx.Module):
    """Frames of one trajectory in order, gaps allowed; a sampler gives a batch of them, stacked.

    - `frames`: values in [0, 1], or None where a sampler gives cached keypoints instead.
    - `keypoints`: cached keypoints, or None.
    - `index`: frame numbers, counted from the clip's own first frame.
    - `u`: the input, `[l]` constant or `[length, l]` from the clip's first frame on.
    - `dt`: seconds between consecutive frame numbers.
    - `span`: the largest frame number that `index` may hold, plus one; known at compile time.
    """

    frames: Float[Array, "*batch F H W 3"] | None
    cached: Float[Array, "*batch F dim"] | None
    index: Int[Array, "*batch F"]
    u: Float[Array, "*batch l"] | Float[Array, "*batch span l"]
    dt: Float[Array, "*batch"]
    span: int = eqx.field(static=True)


class AbstractSampler(eqx.Module):
    """Draws the batch of clips of a step from resident data; a pure function of key and step number."""

    @abstractmethod
    def span(self) -> int:
        """How many consecutive frames a trajectory must have at least."""

    @abstractmethod
    def __call__(self, data: Resident, key: PRNGKeyArray, step: Int[Array, ""]) -> Clip:
        """A batch of clips; `key` is the same for all steps of a stage."""

    def check(self, data: Resident) -> None:
        """Raises KeycldError when the trajectories are too short."""
        if self.span() > data.image.shape[1]:
            raise KeycldError(
                f"trajectories have {data.image.shape[1]} frames but this recipe samples clips of "
                f"{self.span()}; make longer trajectories or shorten the recipe's horizon."
            )


class RandomFrames(AbstractSampler):
    """Independent single frames, for learning to see. Good values: 16 to 64."""

    batch: int = eqx.field(static=True)

    def span(self) -> int:
        """One."""
        return 1

    def __call__(self, data: Resident, key: PRNGKeyArray, step: Int[Array, ""]) -> Clip:
        """Frames drawn uniformly over all trajectories and times."""
        key_trajectory, key_frame = jax.random.split(jax.random.fold_in(key, step))
        count, length = data.image.shape[:2]
        trajectory = jax.random.randint(key_trajectory, (self.batch,), 0, count)
        start = jax.random.randint(key_frame, (self.batch,), 0, length)
        return _gather(data, trajectory, start, jnp.zeros((self.batch, 1), int), 1)


class StartGroups(AbstractSampler):
    """A few groups of consecutive frames at random places of a window: each can start a motion through all others.

    A long horizon for the price of a few pictures, and every frame is a start as often as it is a target. The window
    grows with the steps, because a motion that starts a little wrong is lost after a long time and teaches
    nothing there. All windows share one compiled step.

    - `batch`: clips a step.
    - `groups`: how many, drawn without overlap, in order.
    - `windows`: frames of the first and of the last possible ones; each holds for an equal part of `steps`.
    - `steps`: of the stage.
    - `cached`: give the keypoints that the stage has cached instead of pictures.
    - `given`: frames of a group; 2 tell position and velocity.
    - `begin`: share of the clips whose window and first group are a trajectory's first frames. Predictions start
      there, often from rest, and postures that all trajectories begin with are rare elsewhere.
    """

    batch: int = eqx.field(static=True)
    groups: int = eqx.field(static=True)
    windows: tuple[int, ...] = eqx.field(static=True)
    steps: int = eqx.field(static=True)
    cached: bool = eqx.field(static=True, default=False)
    given: int = eqx.field(static=True, default=2)
    begin: float = eqx.field(static=True, default=0.0)

    def __check_init__(self):
        """Every window has room for the groups."""
        least = self.groups * self.given
        if min(self.windows) < least:
            raise KeycldError(
                f"a window of {min(self.windows)} frames has no room for {self.groups} groups of {self.given} frames; "
                f"make it {least} or longer, or ask for fewer groups."
            )

    def span(self) -> int:
        """The longest window."""
        return max(self.windows)

    def __call__(self, data: Resident, key: PRNGKeyArray, step: Int[Array, ""]) -> Clip:
        """Clips drawn uniformly over all trajectories and places of the window."""
        keys = jax.random.split(jax.random.fold_in(key, step), 5)
        count, length = data.image.shape[:2]
        phase = jnp.clip(step * len(self.windows) // self.steps, 0, len(self.windows) - 1)
        window = jnp.array(self.windows)[phase]
        trajectory = jax.random.randint(keys[0], (self.batch,), 0, count)
        begins = jax.random.bernoulli(keys[4], self.begin, (self.batch,))
        start = jnp.where(begins, 0, jax.random.randint(keys[1], (self.batch,), 0, length - window + 1))
        # Groups fill slots side by side; where there is room all slots are shifted, or no group would begin between.
        room = jnp.minimum(self.given, window - self.groups * self.given + 1)
        shift = jnp.where(begins[:, None], 0, jax.random.randint(keys[2], (self.batch, 1), 0, room))
        first = shift + self.given * jnp.arange(self.span() // self.given)[None, :]
        # The slots with the smallest random numbers are a draw without repetition; those too late have none.
        lot = jax.random.uniform(keys[3], first.shape) + (first + self.given > window)
        lot = lot.at[:, 0].add(-1.0 * begins)
        chosen = jnp.sort(jnp.argsort(lot, axis=1)[:, : self.groups], axis=1)
        within = jnp.take_along_axis(first, chosen, axis=1)[:, :, None] + jnp.arange(self.given)[None, None, :]
        return _gather(data, trajectory, start, within.reshape(self.batch, -1), self.span(), frames=not self.cached)


class WholeTrajectories(AbstractSampler):
    """Whole trajectories, each once an epoch in a new random order (the paper's batches hold one).

    Args:
        length: frames of a trajectory.
        batch: trajectories a step.
    """

    length: int = eqx.field(static=True)
    batch: int = eqx.field(static=True, default=1)

    def span(self) -> int:
        """Return the length of a trajectory."""
        return self.length

    def check(self, data: Resident) -> None:
        """Raise KeycldError where the trajectories are too short or too few."""
        super().check(data)
        if self.batch > data.image.shape[0]:
            raise KeycldError(
                f"a batch of {self.batch} whole trajectories needs as many, but there are {data.image.shape[0]}: set "
                "batch to fewer."
            )

    def __call__(self, data: Resident, key: PRNGKeyArray, step: Int[Array, ""]) -> Clip:
        """Return the trajectories of this step."""
        count = data.image.shape[0]
        epoch, place = jnp.divmod(step, count // self.batch)
        order = jax.random.permutation(jax.random.fold_in(key, epoch), count)
        trajectory = jax.lax.dynamic_slice_in_dim(order, place * self.batch, self.batch)
        index = jnp.broadcast_to(jnp.arange(self.length)[None, :], (self.batch, self.length))
        return _gather(data, trajectory, jnp.zeros(self.batch, int), index, self.length)


def _gather(data: Resident, trajectory: Array, start: Array, index: Array, span: int, *, frames: bool = True) -> Clip:
    rows, columns = trajectory[:, None], start[:, None] + index
    held = jnp.minimum(start[:, None] + jnp.arange(span)[None, :], data.image.shape[1] - 1)
    u = data.u[trajectory] if data.u.ndim == 2 else data.u[rows, held]
    return Clip(
        frames=data.image[rows, columns].astype(jnp.float32) / 255.0 if frames else None,
        cached=None if frames or data.cached is None else data.cached[rows, columns],
        index=index,
        u=u,
        dt=jnp.broadcast_to(data.dt, trajectory.shape),
        span=span,
    )
