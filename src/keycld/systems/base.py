"""What every system offers: its motion, its pictures, and the keypoints that suit it."""

import abc
import dataclasses
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

import numpy as np

from keycld._errors import KeycldError

if TYPE_CHECKING:
    import keycld.mechanics


@dataclass(frozen=True)
class Conditions:
    """Inputs and initial states of runs.

    Attributes:
        control: which inputs act: `"full"`, all; `"under"`, all but the second; `"none"`, no input; the name of an
            input: that one alone.
        initial_state: how runs begin: `"rest"`, dm_control's reset of its swing-up tasks; `"random"`, the journal
            version's, all positions and velocities random; `"upright"`, the same in half of the runs, and in the
            others close to upright, positions off by a normal 0.2 rad (or m) and velocities by 1/s; `"released"`,
            released from rest at any position; `"moving"`, anywhere in motion, with an energy in a range of the
            system.
        input_limit: u is sampled uniformly from ± this.
        clip: whether the motors limit u to the system's `input_range`.
        input: `"constant"` in a run, or a `"random-walk"`: held for a frame, then moved by a normal number of deviation
            0.15 `input_limit` and reflected at ± `input_limit`. Inputs that are zero stay zero.
        idle_number: whether the random number that decides if u is zero is also taken from the generator where no input
            acts. The released code of 2024 does not take it, so there the initial states with `control="none"`
            differ from those with `"full"`.

    Good values: the defaults are those of arXiv v1 (2022); the journal version (2024) has `initial_state="random"`,
    `input_limit=2`, `clip=False`, `idle_number=False`.
    """

    control: str = "full"
    initial_state: str = "rest"
    input_limit: float = 3.0
    clip: bool = True
    input: str = "constant"
    idle_number: bool = True

    def described(self) -> dict[str, Any]:
        """Return the fields by name, for records.

        `input` is left out where it is constant, `idle_number` where it changes nothing: records from before these
        choices stay valid.
        """
        fields = dataclasses.asdict(self)
        if self.input == "constant":
            del fields["input"]
        if self.idle_number or self.control != "none":
            del fields["idle_number"]
        return fields


class Run(NamedTuple):
    """One simulated recording of T frames, without its pictures; all arrays are float64.

    Attributes:
        time: [T], seconds.
        input: [l], constant in the run, or [T, l], held from frame k to k + 1.
        state: [T, d], in the system's units.
        state_derivative: [T, d].
    """

    time: np.ndarray
    input: np.ndarray
    state: np.ndarray
    state_derivative: np.ndarray


class SweepPath(NamedTuple):
    """States along a path or over a grid of the configuration space, at rest.

    Attributes:
        name: of the path.
        state: [n, d].
        shape: (n,) for a path, (rows, columns) for a grid, stored row by row.
        vary: names of the states that change, one for each axis of `shape`.
    """

    name: str
    state: np.ndarray
    shape: tuple[int, ...]
    vary: tuple[str, ...]


class StateRenderer(Protocol):
    """Renders a system's states; `description` names the renderer, for example the OpenGL device."""

    description: str

    def render(self, state: np.ndarray) -> np.ndarray:
        """Return the picture, uint8 `[size, size, 3]`, of one state `[d]`."""
        ...


class AbstractSystem(abc.ABC):
    """Something that moves and can be watched.

    Attributes:
        name: in lower case; a slash separates a family from its member.
        dt: seconds between frames.
        size: pixels of a side.
        state_names: one for each component of the state, all positions first, then all velocities or momenta.
        units: of these, in the same order.
        input_names: one for each input; empty where nothing drives the system.
        keypoints: names of the suggested keypoints; empty where the system suggests none.
        looks_differ: whether the parts look different from recording to recording, for example in colour.
        parameters_differ: whether masses, places or lengths differ from recording to recording.
    """

    name: ClassVar[str]
    dt: ClassVar[float]
    size: ClassVar[int] = 64
    state_names: ClassVar[tuple[str, ...]]
    units: ClassVar[tuple[str, ...]]
    input_names: ClassVar[tuple[str, ...]] = ()
    keypoints: ClassVar[tuple[str, ...]] = ()
    looks_differ: ClassVar[bool] = False
    parameters_differ: ClassVar[bool] = False

    @property
    def constraints(self) -> "keycld.mechanics.Constraints | None":
        """The constraints Φ suggested for `keypoints`, or None where the system suggests none.

        Only DΦ matters, so their constants need not fit.
        """
        return None

    def landmarks(self, state: np.ndarray) -> np.ndarray:
        """Return the true positions `[..., K, 2]` of the K `keypoints` in the image plane, for states `[..., d]`.

        x right, y up, ±1 at the centres of the outermost pixels. K is 0 where the system suggests no keypoints. For
        evaluation only, never for training.
        """
        return np.zeros((*np.shape(state)[:-1], 0, 2))


class AbstractMechanism(AbstractSystem):
    """A system with motors, simulated one run at a time and shown by a renderer of its own.

    Attributes:
        input_range: the largest |u| of its motors where they are limited.
        initial_states: those of `Conditions.initial_state` that it knows.
        protocol: that its data follow by default.
    """

    protocol: ClassVar[str] = "keycld-2022"
    input_range: ClassVar[float]
    initial_states: ClassVar[tuple[str, ...]]

    @property
    @abc.abstractmethod
    def control_modes(self) -> tuple[str, ...]:
        """The values of `Conditions.control` that the system knows."""

    @property
    @abc.abstractmethod
    def constraints(self) -> "keycld.mechanics.Constraints":
        """The constraints Φ suggested for `keypoints`."""

    @abc.abstractmethod
    def landmarks(self, state: np.ndarray) -> np.ndarray:
        """Return the true positions `[..., K, 2]` of `keypoints` for states `[..., d]`; see `AbstractSystem`."""

    @abc.abstractmethod
    def record(self, random: np.random.RandomState, frames: int, conditions: Conditions) -> Run:
        """Simulate one run with input and initial state from `random`; frame k shows the state after step k + 1."""

    @abc.abstractmethod
    def sweeps(self) -> tuple[SweepPath, ...]:
        """Return the paths and the grid of the energy figures (Figs. 8 to 12 of the paper)."""

    @abc.abstractmethod
    def open_renderer(self) -> AbstractContextManager[StateRenderer]:
        """Return a context in which this process renders the system; keep to one system a process."""

    def check(self, conditions: Conditions) -> None:
        """Raise `KeycldError` where the system does not know the conditions."""
        if conditions.control not in self.control_modes:
            raise KeycldError(
                f"{self.name} has no control mode '{conditions.control}': choose from {', '.join(self.control_modes)}."
            )
        if conditions.initial_state not in self.initial_states:
            raise KeycldError(
                f"{self.name} has no initial state '{conditions.initial_state}': "
                f"choose from {', '.join(self.initial_states)}."
            )
        if conditions.input not in ("constant", "random-walk"):
            raise KeycldError(f"an input is constant or a random-walk, not '{conditions.input}'.")
        if not (np.isfinite(conditions.input_limit) and conditions.input_limit >= 0):
            raise KeycldError(f"input_limit must be a number of at least 0, not {conditions.input_limit}.")
