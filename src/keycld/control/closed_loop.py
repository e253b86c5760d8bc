"""The closed loop: MuJoCo simulates and renders, the agent turns each picture into an input."""

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld._errors import KeycldError
from keycld.control.agent import Agent, AgentState
from keycld.control.plant import Plant
from keycld.systems import AbstractMujocoSystem


@dataclass(frozen=True)
class Disturbance:
    """Disturbance of the pictures between camera and agent.

    Attributes:
        noise: deviation of normal noise on every pixel and colour, as a share of the full range.
        dropped: probability that a frame does not arrive.
    """

    noise: float = 0.0
    dropped: float = 0.0

    def __post_init__(self):
        """Check that both are shares."""
        if not 0 <= self.noise <= 1:
            raise KeycldError(f"--noise is a share from 0 to 1, not {self.noise:g}.")
        if not 0 <= self.dropped < 1:
            raise KeycldError(f"--drop is a probability of at least 0 and below 1, not {self.dropped:g}.")

    def __call__(self, random: np.random.Generator, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the frames as they arrive, and which of them do."""
        arrived = random.random(len(frames)) >= self.dropped
        if self.noise == 0:
            return frames, arrived
        noisy = frames + 255.0 * self.noise * random.standard_normal(frames.shape, np.float32)
        return np.clip(np.round(noisy), 0, 255).astype(np.uint8), arrived


@dataclass(frozen=True)
class ClosedLoopRun:
    """`N` copies of a system under control for `T` frames.

    Attributes:
        dt: seconds between frames.
        state: [N, T + 1, d], true states, before the first input and after each.
        input: [N, T, l], of the system, held from frame k to k + 1.
        x: [N, T, 2K], estimated positions of the keypoints, image-plane units.
        v: [N, T, 2K], their estimated velocities, units/s.
        arrived: [N, T], whether frame k reached the agent.
        frames: uint8 [T + 1, H, W, 3], pictures of the first copy.
        step_seconds: [T], computing time from frame to input, of the first copy.
        missed: [T], whether that was longer than dt, so that the last input was held.
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


def run_closed_loop(
    agent: Agent,
    system: AbstractMujocoSystem,
    initial_states: np.ndarray,
    seconds: float,
    *,
    inputs: tuple[int, ...] | None = None,
    disturbance: Disturbance = Disturbance(),
    seed: int = 0,
    on_first: Callable[[AgentState], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
    workers: int | None = None,
) -> ClosedLoopRun:
    """Control copies of a system from their pictures.

    The first copy runs as a real system would: one frame at a time through one compiled function, which is timed. Where
    a step takes longer than a frame, the miss is counted and the last input is held. The other copies run in one batch,
    for statistics. An input acts from the frame that it was computed from: the simulation waits for it, as in the
    training data, and also for plans that are made between frames. Rendering is the camera's work and not part of a
    step.

    Args:
        agent: maps frames to inputs.
        system: simulated by MuJoCo.
        initial_states: [N, d], true states at the first frame.
        seconds: duration.
        inputs: which of the system's inputs the agent gives, in its order; the others stay zero. None: all.
        disturbance: of the pictures.
        seed: of the disturbance.
        on_first: called with the agents' memory after the first frame, stacked.
        progress: called with the number of frames done and their total.
        workers: processes that simulate and render; by default one a core.
    """
    steps = round(seconds / system.dt)
    random = np.random.default_rng(seed)
    alone, together = _compiled(agent)
    count = len(initial_states)
    columns = list(range(len(system.input_names)) if inputs is None else inputs)
    groups = [slice(0, 1), slice(1, count)] if count > 1 else [slice(0, 1)]
    states = [_copies(agent.initial_state(), group.stop - group.start) for group in groups]
    held = np.zeros((count, len(columns)), np.float32)
    applied = np.zeros((count, len(system.input_names)), np.float32)
    record: dict[str, list[np.ndarray]] = {name: [] for name in ("state", "input", "x", "v", "arrived", "frames")}
    step_seconds, missed = np.zeros(steps), np.zeros(steps, bool)

    with Plant(system, initial_states, workers) as plant:
        frames = plant.look()
        jax.block_until_ready(alone(_only(states[0]), frames[0], True, held[0]))  # compile before the first timed step
        record["state"].append(plant.state)
        for k in range(steps):
            record["frames"].append(frames[0])
            shown, arrived = disturbance(random, frames)

            one = _only(states[0])
            before = time.perf_counter()
            one, u = jax.block_until_ready(alone(one, shown[0], arrived[0], held[0]))
            step_seconds[k] = time.perf_counter() - before
            missed[k] = step_seconds[k] > system.dt
            states[0] = jax.tree.map(lambda leaf: leaf[None], one)
            chosen = [np.asarray(u)[None] if not missed[k] else held[:1]]
            if count > 1:
                states[1], us = together(states[1], shown[1:], arrived[1:], held[1:])
                chosen.append(np.asarray(us))
            if k == 0 and on_first is not None:
                on_first(jax.tree.map(lambda *parts: jnp.concatenate(parts), *states))
            held = np.concatenate(chosen)
            for i, (belief, memory) in enumerate(states):
                states[i] = AgentState(belief, agent.controller.replan(belief, memory, held[groups[i]]))

            motion = [each.belief.state.coordinates for each in states]
            record["x"].append(np.concatenate([each.x for each in motion]))
            record["v"].append(np.concatenate([each.v for each in motion]))
            applied = applied.copy()
            applied[:, columns] = held
            record["input"].append(applied)
            record["arrived"].append(arrived)
            frames = plant.advance(applied)
            record["state"].append(plant.state)
            if progress is not None:
                progress(k + 1, steps)
        record["frames"].append(frames[0])

    stacked = {name: np.stack(values, axis=0 if name == "frames" else 1) for name, values in record.items()}
    return ClosedLoopRun(dt=system.dt, step_seconds=step_seconds, missed=missed, **stacked)


def _compiled(agent: Agent) -> tuple[Callable, Callable]:
    """Return the agent for one copy and for several. Weights are arguments: as constants they would compile slowly."""
    arrays, static = eqx.partition(agent, eqx.is_array)
    one = jax.jit(lambda arrays, *rest: eqx.combine(arrays, static)(*rest))
    many = jax.jit(lambda arrays, *rest: jax.vmap(eqx.combine(arrays, static))(*rest))
    return functools.partial(one, arrays), functools.partial(many, arrays)


def _copies(one: AgentState, count: int) -> AgentState:
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count, *jnp.shape(leaf))), one)


def _only(batch: AgentState) -> AgentState:
    return jax.tree.map(lambda leaf: leaf[0], batch)
