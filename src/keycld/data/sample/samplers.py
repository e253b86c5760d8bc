"""Samplers: which clips a training step sees."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, PRNGKeyArray

from keycld._errors import KeycldError
from keycld.data.sample.clips import Clip, gather
from keycld.data.sample.resident import Resident
from keycld.data.sample.training_data import TrainingData


class AbstractSampler(eqx.Module):
    """Samples the batch of clips of a step from resident data; a pure function of key and step number."""

    @abstractmethod
    def span(self) -> int:
        """Tell how many consecutive frames a trajectory must have at least."""

    @abstractmethod
    def __call__(self, data: Resident, key: PRNGKeyArray, step: Int[Array, ""]) -> Clip:
        """Sample a batch of clips; `key` is the same for all steps of a stage."""

    def check(self, data: Resident | TrainingData) -> None:
        """Refuse trajectories that are too short.

        Raises:
            KeycldError: a clip is longer than they are.
        """
        if self.span() > data.shape[1]:
            raise KeycldError(
                f"trajectories have {data.shape[1]} frames but this recipe samples clips of "
                f"{self.span()}; make longer trajectories or shorten the recipe's horizon."
            )


class RandomFrames(AbstractSampler):
    """Independent frames, for training an image encoder.

    Attributes:
        batch: clips a step. Good values: 16 to 64.
        together: frames of a clip, from anywhere in one trajectory.
        cached: give also the values that the stage has cached, which are not finite for frames without any: only
            trajectories with some, and only such frames, are sampled.
    """

    batch: int = eqx.field(static=True)
    together: int = eqx.field(static=True, default=1)
    cached: bool = eqx.field(static=True, default=False)

    def span(self) -> int:
        """Return 1."""
        return 1

    def __call__(self, data: Resident, key: PRNGKeyArray, step: Int[Array, ""]) -> Clip:
        """Sample frames uniformly over all trajectories and times; `index` counts from the trajectory's first frame."""
        key_trajectory, key_frame = jax.random.split(jax.random.fold_in(key, step))
        count, length = data.image.shape[:2]
        trajectory = jax.random.randint(key_trajectory, (self.batch,), 0, count)
        frame = jax.random.randint(key_frame, (self.batch, self.together), 0, length)
        if self.cached and data.cached is not None:
            there = jnp.isfinite(data.cached[:, :, 0])
            some = jnp.any(there, axis=1)
            trajectory = jax.random.choice(key_trajectory, count, (self.batch,), p=some / jnp.sum(some))
            # The frames with the largest random numbers are a sample without repetition.
            lot = jax.random.uniform(key_frame, (self.batch, length)) + there[trajectory]
            frame = jnp.argsort(-lot, axis=1)[:, : self.together]
        return gather(data, trajectory, jnp.zeros(self.batch, int), frame, length, cached=self.cached)


class FrameGroups(AbstractSampler):
    """A few groups of consecutive frames at random places of a window: each can give an initial state for all others.

    So a long horizon costs few pictures, and every frame is as often part of an initial state as it is a target. The
    window grows with the steps: over a long time, a motion with a slightly wrong initial state ends anywhere, and its
    error teaches nothing. All windows share one compiled step.

    Attributes:
        batch: clips a step.
        groups: groups a clip, sampled without overlap, in order.
        windows: frames of the window; each value holds for an equal part of `steps`.
        steps: of the stage; a float, because the compiled program does not depend on floats.
        cached: give the values that the stage has cached instead of pictures.
        given: frames of a group; 2 determine position and velocity.
        first_frames: share of the clips whose window and first group are the first frames of a trajectory. Predictions
            begin there, often at rest, and the poses there may be rare elsewhere.
    """

    batch: int = eqx.field(static=True)
    groups: int = eqx.field(static=True)
    windows: tuple[int, ...] = eqx.field(static=True)
    steps: float
    cached: bool = eqx.field(static=True, default=False)
    given: int = eqx.field(static=True, default=2)
    first_frames: float = 0.0

    def __check_init__(self):
        """Check that every window has room for the groups."""
        least = self.groups * self.given
        if min(self.windows) < least:
            raise KeycldError(
                f"a window of {min(self.windows)} frames has no room for {self.groups} groups of {self.given} frames; "
                f"make it {least} or longer, or ask for fewer groups."
            )

    def span(self) -> int:
        """Return the longest window."""
        return max(self.windows)

    def __call__(self, data: Resident, key: PRNGKeyArray, step: Int[Array, ""]) -> Clip:
        """Sample clips uniformly over all trajectories and places of the window."""
        keys = jax.random.split(jax.random.fold_in(key, step), 5)
        count, length = data.image.shape[:2]
        phase = jnp.clip((step * len(self.windows) / self.steps).astype(int), 0, len(self.windows) - 1)
        window = jnp.array(self.windows)[phase]
        trajectory = jax.random.randint(keys[0], (self.batch,), 0, count)
        begins = jax.random.bernoulli(keys[4], self.first_frames, (self.batch,))
        start = jnp.where(begins, 0, jax.random.randint(keys[1], (self.batch,), 0, length - window + 1))
        # Groups fill adjacent slots. All slots are shifted by a random number, so that a group may begin at any frame.
        room = jnp.minimum(self.given, window - self.groups * self.given + 1)
        shift = jnp.where(begins[:, None], 0, jax.random.randint(keys[2], (self.batch, 1), 0, room))
        first = shift + self.given * jnp.arange(self.span() // self.given)[None, :]
        # The slots with the smallest random numbers are a sample without repetition; slots that end too late are last.
        lot = jax.random.uniform(keys[3], first.shape) + (first + self.given > window)
        lot = lot.at[:, 0].add(-1.0 * begins)
        chosen = jnp.sort(jnp.argsort(lot, axis=1)[:, : self.groups], axis=1)
        within = jnp.take_along_axis(first, chosen, axis=1)[:, :, None] + jnp.arange(self.given)[None, None, :]
        return gather(data, trajectory, start, within.reshape(self.batch, -1), self.span(), frames=not self.cached)


class WholeTrajectories(AbstractSampler):
    """Whole trajectories, each once an epoch in a new random order; the batches of arXiv v1 hold one.

    Attributes:
        length: frames of a trajectory.
        batch: trajectories a step.
    """

    length: int = eqx.field(static=True)
    batch: int = eqx.field(static=True, default=1)

    def span(self) -> int:
        """Return the length of a trajectory."""
        return self.length

    def check(self, data: Resident) -> None:
        """Refuse trajectories that are too short or too few.

        Raises:
            KeycldError: says how many there are and how many are needed.
        """
        super().check(data)
        if self.batch > data.image.shape[0]:
            raise KeycldError(
                f"a batch of {self.batch} whole trajectories needs as many, but there are {data.image.shape[0]}: set "
                "batch to fewer."
            )

    def __call__(self, data: Resident, key: PRNGKeyArray, step: Int[Array, ""]) -> Clip:
        """Give the trajectories of this step."""
        count = data.image.shape[0]
        epoch, place = jnp.divmod(step, count // self.batch)
        order = jax.random.permutation(jax.random.fold_in(key, epoch), count)
        trajectory = jax.lax.dynamic_slice_in_dim(order, place * self.batch, self.batch)
        index = jnp.broadcast_to(jnp.arange(self.length)[None, :], (self.batch, self.length))
        return gather(data, trajectory, jnp.zeros(self.batch, int), index, self.length)


class Windows(AbstractSampler):
    """Windows of consecutive frames, uniform over all trajectories and first frames.

    The batches of "Which priors matter?".

    Attributes:
        batch: windows a step.
        length: frames of a window.
    """

    batch: int = eqx.field(static=True)
    length: int = eqx.field(static=True)

    def span(self) -> int:
        """Return the length of a window."""
        return self.length

    def __call__(self, data: Resident, key: PRNGKeyArray, step: Int[Array, ""]) -> Clip:
        """Sample windows: `frames` `[batch, length, H, W, 3]`, `index` 0 … length − 1, and the input of the window."""
        key_trajectory, key_frame = jax.random.split(jax.random.fold_in(key, step))
        count, frames = data.image.shape[:2]
        trajectory = jax.random.randint(key_trajectory, (self.batch,), 0, count)
        first = jax.random.randint(key_frame, (self.batch,), 0, frames - self.length + 1)
        index = jnp.broadcast_to(jnp.arange(self.length), (self.batch, self.length))
        return gather(data, trajectory, first, index, self.length)
