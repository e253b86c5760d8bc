"""Gymnasium environments over the MuJoCo systems. Importing this module registers them, and needs Gymnasium."""

from typing import Any

import gymnasium
import numpy as np

from keycld._errors import KeycldError
from keycld.control.plant import Plant
from keycld.control.requirements import check_limit, positions_of
from keycld.systems import AbstractMujocoSystem, get, names

_SECONDS = 10.0


class SwingUp(gymnasium.Env[np.ndarray, np.ndarray]):
    """A swing-up task whose observations are the camera's pictures.

    | | |
    |---|---|
    | observation | picture, uint8 `[64, 64, 3]` |
    | action | float32 `[a]` in ±1, multiplied by `limit`; without a limit the input itself, unbounded |
    | reward | mean over links of (1 + cos tilt)/2, in [0, 1]: 1 upright, 0 hanging |
    | `info` | `state` `[d]`, true; `landmarks` `[K, 2]`, true keypoints in image-plane units; `tilts`; `input` `[l]` |
    | terminated | never |
    | truncated | after 10 s, by Gymnasium's time limit |

    The input is held for one frame (the system's dt), and the picture shows the state after it. Pictures are
    rendered in a separate process, so several environments may be open at once; `close` ends it.

    Args:
        system: name of a MuJoCo system.
        limit: the largest |u|; None or infinity for no limit. The data of arXiv v1 have 3.
        actuators: names of the inputs that act, the others stay zero; None for all.
        initial_state: `"rest"`, dm_control's reset of the swing-up task, or `"random"`, any position at rest (slider
            in ±1 m). `reset(options={"state": [...]})` sets the state instead.
        render_mode: None or `"rgb_array"`.

    Raises:
        KeycldError: an argument is out of its range.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}

    def __init__(
        self,
        system: str,
        limit: float | None = 3.0,
        actuators: tuple[str, ...] | None = None,
        initial_state: str = "rest",
        render_mode: str | None = None,
    ):
        found = get(system)
        if not isinstance(found, AbstractMujocoSystem):
            possible = ", ".join(names(AbstractMujocoSystem))
            raise KeycldError(f"{system} has no environment: choose from {possible}.")
        if initial_state not in ("rest", "random"):
            raise KeycldError(f"the initial state of an environment is rest or random, not '{initial_state}'.")
        self.system = found
        self.metadata = {**self.metadata, "render_fps": round(1 / found.dt)}
        self.render_mode = render_mode
        self._initial_state = initial_state
        largest = check_limit(limit)
        self._scale, self._bound = (largest, 1.0) if np.isfinite(largest) else (1.0, np.inf)
        self._actuators = list(positions_of(found.input_names, None if actuators is None else tuple(actuators)))
        self.action_space = gymnasium.spaces.Box(-self._bound, self._bound, (len(self._actuators),), np.float32)
        self.observation_space = gymnasium.spaces.Box(0, 255, (found.size, found.size, 3), np.uint8)
        self._plant: Plant | None = None
        self._picture = np.zeros((found.size, found.size, 3), np.uint8)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; `options={"state": [d numbers]}` sets its initial state."""
        super().reset(seed=seed)
        given = (options or {}).get("state")
        state = self._sample_state() if given is None else np.asarray(given, float)
        if state.shape != (len(self.system.state_names),):
            raise KeycldError(
                f"a state of {self.system.name} is {', '.join(self.system.state_names)}, not {given}: give "
                f"{len(self.system.state_names)} numbers."
            )
        if self._plant is None:
            self._plant = Plant(self.system, state[None], workers=1)
        self._plant.state = state[None]
        self._picture = self._plant.look()[0]
        return self._picture.copy(), self._info(np.zeros(len(self.system.input_names)))

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold an action for one frame."""
        if self._plant is None:
            raise KeycldError("call reset() before step().")
        u = np.zeros(len(self.system.input_names))
        u[self._actuators] = self._scale * np.clip(action, -self._bound, self._bound)
        self._picture = self._plant.advance(u[None])[0]
        info = self._info(u)
        reward = float(np.mean((1 + np.cos(info["tilts"])) / 2))
        return self._picture.copy(), reward, False, False, info

    def render(self) -> np.ndarray | None:
        """Return the latest picture."""
        return self._picture.copy() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """End the process that renders."""
        if self._plant is not None:
            self._plant.__exit__(None, None, None)
            self._plant = None

    def _sample_state(self) -> np.ndarray:
        random = np.random.RandomState(self.np_random.integers(2**31))
        if self._initial_state == "rest":
            return np.concatenate(self.system.rest(random))
        position = self.system.positions(random, slider_limit=1.0)
        return np.concatenate([position, np.zeros_like(position)])

    def _info(self, u: np.ndarray) -> dict[str, Any]:
        assert self._plant is not None
        state = self._plant.state[0].copy()
        return {
            "state": state,
            "landmarks": self.system.landmarks(state),
            "tilts": self.system.tilts(state),
            "input": u,
        }


def register() -> None:
    """Make `gymnasium.make("keycld/Pendulum-v0")`, `Cartpole-v0` and `Acrobot-v0` known."""
    for name in ("pendulum", "cartpole", "acrobot"):
        if (known := f"keycld/{name.capitalize()}-v0") in gymnasium.registry:
            continue
        gymnasium.register(
            id=known,
            entry_point=f"{__name__}:{SwingUp.__name__}",
            kwargs={"system": name},
            max_episode_steps=round(_SECONDS / get(name).dt),
        )


register()
