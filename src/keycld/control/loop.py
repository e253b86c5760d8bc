"""The closed loop: MuJoCo moves and is photographed, the pilot sees and pushes."""

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld._errors import KeycldError
from keycld.control.pilot import Aboard, Pilot
from keycld.control.plant import Plant
from keycld.systems import AbstractMujocoSystem


@dataclass(frozen=True)
class Disturbance:
    """What happens to pictures between camera and pilot.

    Attributes:
        noise: deviation of normal noise on every pixel and colour, as a part of the full range.
        dropped: probability that a frame does not arrive.
    """

    noise: float = 0.0
    dropped: float = 0.0

    def __post_init__(self):
        """Both are shares."""
        if not (0 <= self.noise <= 1 and 0 <= self.dropped < 1):
            raise KeycldError(f"noise and dropped frames are parts of 1, not {self.noise} and {self.dropped}.")

    def __call__(self, random: np.random.Generator, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The frames as they arrive, and which of them do."""
        arrived = random.random(len(frames)) >= self.dropped
        if self.noise == 0:
            return frames, arrived
        noisy = frames + 255.0 * self.noise * random.standard_normal(frames.shape, np.float32)
        return np.clip(np.round(noisy), 0, 255).astype(np.uint8), arrived


@dataclass(frozen=True)
class Flight:
    """`N` copies of a system under control for `T` frames.

    Attributes:
        dt: seconds between frames.
        state: [N, T + 1, d], true, before the first input and after each.
        input: [N, T, l], as held from frame k to k + 1.
        x: [N, T, 2K], where the pilot believed the keypoints to be.
        v: [N, T, 2K], their velocities.
        arrived: [N, T], whether frame k reached the pilot.
        frames: uint8 [T + 1, H, W, 3], pictures of the first copy.
        step_seconds: [T], from frame to input, the first copy's.
        missed: [T], whether that took longer than dt, so that the last input was held.
    """

    dt: float
    state: np.ndarray
    input: np.ndarray
    x: np.ndarray
    v: np.ndarray
    arrived: np.ndarray
    frames: np.ndarray
    step_seconds: np.ndarray
    missed: np.ndarray


def fly(
    pilot: Pilot,
    system: AbstractMujocoSystem,
    starts: np.ndarray,
    seconds: float,
    *,
    disturbance: Disturbance = Disturbance(),
    seed: int = 0,
    on_first: Callable[[Aboard], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
    workers: int | None = None,
) -> Flight:
    """Control copies of a system from their pictures.

    The first copy is flown as a real one would be: one frame at a time through one compiled function, timed; where that
    takes longer than a frame, the miss is counted and the last input held. The others run beside it in one batch, for
    statistics. An input acts from the frame that it was computed from: the world waits for it, as in the training data,
    and also for plans that are made between frames. Drawing is the camera's work and not part of a step.

    Args:
        pilot: what turns frames into inputs.
        system: simulated by MuJoCo.
        starts: [N, d], true states at the start.
        seconds: how long.
        disturbance: of the pictures.
        seed: of the disturbance.
        on_first: called with what every pilot makes of the first frame, stacked.
        progress: called with the number of frames done and their total.
        workers: processes that simulate and draw; by default one a core.
    """
    steps = round(seconds / system.dt)
    random = np.random.default_rng(seed)
    alone, together = _compiled(pilot)
    count, inputs = len(starts), len(system.input_names)
    groups = [slice(0, 1), slice(1, count)] if count > 1 else [slice(0, 1)]
    aboard = [_copies(pilot.begin(), group.stop - group.start) for group in groups]
    held = np.zeros((count, inputs), np.float32)
    record: dict[str, list[np.ndarray]] = {name: [] for name in ("state", "input", "x", "v", "arrived", "frames")}
    step_seconds, missed = np.zeros(steps), np.zeros(steps, bool)

    with Plant(system, starts, workers) as plant:
        frames = plant.look()
        jax.block_until_ready(alone(_only(aboard[0]), frames[0], True, held[0]))  # compile before the clock runs
        record["state"].append(plant.state)
        for k in range(steps):
            record["frames"].append(frames[0])
            shown, arrived = disturbance(random, frames)

            one = _only(aboard[0])
            began = time.perf_counter()
            one, u = jax.block_until_ready(alone(one, shown[0], arrived[0], held[0]))
            step_seconds[k] = time.perf_counter() - began
            missed[k] = step_seconds[k] > system.dt
            aboard[0] = jax.tree.map(lambda leaf: leaf[None], one)
            chosen = [np.asarray(u)[None] if not missed[k] else held[:1]]
            if count > 1:
                aboard[1], us = together(aboard[1], shown[1:], arrived[1:], held[1:])
                chosen.append(np.asarray(us))
            if k == 0 and on_first is not None:
                on_first(jax.tree.map(lambda *parts: jnp.concatenate(parts), *aboard))
            held = np.concatenate(chosen)
            for i, (belief, memory) in enumerate(aboard):
                aboard[i] = Aboard(belief, pilot.controller.attend(belief, memory, held[groups[i]]))

            motion = [each.belief.state.coordinates for each in aboard]
            record["x"].append(np.concatenate([each.x for each in motion]))
            record["v"].append(np.concatenate([each.v for each in motion]))
            record["input"].append(held)
            record["arrived"].append(arrived)
            frames = plant.advance(held)
            record["state"].append(plant.state)
            if progress is not None:
                progress(k + 1, steps)
        record["frames"].append(frames[0])

    stacked = {name: np.stack(values, axis=0 if name == "frames" else 1) for name, values in record.items()}
    return Flight(dt=system.dt, step_seconds=step_seconds, missed=missed, **stacked)


def _compiled(pilot: Pilot) -> tuple[Callable, Callable]:
    """The pilot for one copy and for several. Weights are arguments: as constants they would compile for long."""
    arrays, static = eqx.partition(pilot, eqx.is_array)
    one = jax.jit(lambda arrays, *rest: eqx.combine(arrays, static)(*rest))
    many = jax.jit(lambda arrays, *rest: jax.vmap(eqx.combine(arrays, static))(*rest))
    return functools.partial(one, arrays), functools.partial(many, arrays)


def _copies(one: Aboard, count: int) -> Aboard:
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count, *jnp.shape(leaf))), one)


def _only(batch: Aboard) -> Aboard:
    return jax.tree.map(lambda leaf: leaf[0], batch)
