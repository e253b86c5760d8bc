"""What an engineer would do: track colours that were clicked on, write an MJCF model, identify it with mujoco.sysid.

python validation/engineer.py pendulum CLIP --clicks 118 64 --out FILE.json
python validation/engineer.py double-pendulum CLIP --clicks 70 53 65 36 --out FILE.json

The same frames as `keycld watch`: fitted to the first two thirds of the clip, the last third predicted from its first
ten frames. A click is a pixel of the first frame on a part; the part is where the colour is near to that of the pixel,
its track the centroid. Pivot and lengths come from circles. The optimiser is `mujoco.sysid.optimize` (its extra
`mujoco[sysid]` must be installed), the residual a roll-out of MuJoCo from unknown initial states.
"""

import argparse
import importlib
import json
import subprocess
import time
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from mujoco import sysid
from scipy.optimize import least_squares

# Of compiled modules, whose contents a type checker does not see.
_mujoco: Any = importlib.import_module("mujoco")
_rollout: Any = importlib.import_module("mujoco.rollout")
STEPS, GIVEN = 4, 10

PENDULUM = """
<mujoco><option timestep="{step}" integrator="implicitfast" gravity="{across} 0 -{gravity}">
<flag contact="disable"/></option>
<worldbody><body><joint type="hinge" axis="0 -1 0" damping="{damping}" frictionloss="{dry}"/>
<inertial pos="0 0 -1" mass="1" diaginertia="1e-6 1e-6 1e-6"/></body></worldbody></mujoco>
"""
DOUBLE = """
<mujoco><option timestep="{step}" integrator="implicitfast" gravity="{across} 0 -{gravity}">
<flag contact="disable"/></option>
<worldbody><body><joint type="hinge" axis="0 -1 0" damping="{damping}" frictionloss="{dry}"/>
<inertial pos="0 0 -{com}" mass="1" diaginertia="{inertia} {inertia} {inertia}"/>
<body pos="0 0 -{link}"><joint type="hinge" axis="0 -1 0" damping="{damping2}" frictionloss="{dry2}"/>
<inertial pos="0 0 -{com2}" mass="{mass2}" diaginertia="{inertia2} {inertia2} {inertia2}"/>
</body></body></worldbody></mujoco>
"""


def frames_of(path: str) -> tuple[np.ndarray, float]:
    """Return the frames uint8 `[T, H, W, 3]` and frames a second."""
    reader = imageio_ffmpeg.read_frames(path)
    meta = next(reader)
    width, height = meta["size"]
    return np.array([np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]), meta["fps"]


def tracked(frames: np.ndarray, click: tuple[int, int], within: float = 60.0) -> np.ndarray:
    """Return the centroid `[T, 2]` of what has the colour of a pixel of the first frame, half heights, y up."""
    colour = frames[0, click[1], click[0]].astype(float)
    far = np.linalg.norm(frames.astype(float) - colour, axis=-1)
    still = np.median(far, axis=0) < within
    weight = np.clip(within - far, 0, None) * ~still[None]
    rows, columns = np.mgrid[: frames.shape[1], : frames.shape[2]]
    total = weight.sum((1, 2)) + 1e-9
    half = (frames.shape[1] - 1) / 2
    x, y = (weight * columns).sum((1, 2)) / total, (weight * rows).sum((1, 2)) / total
    return np.stack([x / half - 1, 1 - y / half], axis=1)


def circle(points: np.ndarray) -> np.ndarray:
    """Return centre and radius of the nearest circle."""
    start = [*points.mean(axis=0), np.std(points)]
    return least_squares(lambda p: np.hypot(*(points - p[:2]).T) - p[2], start, loss="soft_l1", f_scale=0.02).x


class Problem:
    """An MJCF model with unknown numbers and unknown initial states of several windows."""

    def __init__(self, text: str, numbers: dict[str, tuple[float, float, float]], angles: np.ndarray, dt: float):
        """Take the numbers, each with its nominal value and bounds, and angles `[W, T, n]` of the joints."""
        self.text, self.dt, self.angles = text, dt, angles
        self.params = sysid.ParameterDict()
        for name, (nominal, least, most) in numbers.items():
            self.params.add(sysid.Parameter(name, nominal, least, most))
        rates = (angles[:, 3] - angles[:, 0]) / (3 * dt)
        start = np.concatenate([angles[:, 0], rates], axis=1)
        self.params.add(sysid.Parameter("start", start, start - 20.0, start + 20.0))

    def rolled(self, params: sysid.ParameterDict, frames: int) -> np.ndarray:
        """Return the angles `[W, T, n]`."""
        numbers = {name: float(each.value[0]) for name, each in params.items() if name != "start"}
        model = _mujoco.MjModel.from_xml_string(self.text.format(step=self.dt / STEPS, **numbers))
        starts = np.concatenate([np.zeros((len(self.angles), 1)), params["start"].value], axis=1)
        states, _ = _rollout.rollout(model, _mujoco.MjData(model), starts, nstep=STEPS * (frames - 1))
        q = states[:, STEPS - 1 :: STEPS, 1 : 1 + model.nq]
        return np.concatenate([starts[:, None, 1 : 1 + model.nq], q], axis=1)

    def residual(self, x: np.ndarray, params: sysid.ParameterDict, **_: object) -> tuple:
        """Return the differences of angles as mujoco.sysid wants them."""
        params.update_from_vector(x)
        off = self.rolled(params, self.angles.shape[1]) - self.angles
        return [np.nan_to_num(off, nan=10.0).reshape(-1)], None, None

    def fitted(self) -> sysid.ParameterDict:
        """Return the parameters that mujoco.sysid finds."""
        found, _ = sysid.optimize(
            initial_params=self.params, residual_fn=self.residual, optimizer="scipy", verbose=False, loss="soft_l1"
        )
        return found


def windows(angles: np.ndarray, count: int) -> np.ndarray:
    """Return angles `[T, n]` as windows `[W, T', n]`."""
    length = len(angles) // count
    return angles[: count * length].reshape(count, length, -1)


def main() -> None:
    """Track, identify, predict, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mechanism", choices=("pendulum", "double-pendulum"))
    parser.add_argument("clip")
    parser.add_argument("--clicks", type=int, nargs="+", required=True)
    parser.add_argument("--windows", type=int, default=1)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    began = time.process_time()
    frames, fps = frames_of(options.clip)
    clicks = [(a, b) for a, b in zip(options.clicks[::2], options.clicks[1::2], strict=True)]
    points = [tracked(frames, click) for click in clicks]
    fitted, dt = len(frames) - round(len(frames) / 3), 1 / fps
    x, y, radius = circle(points[0][:fitted])
    away = points[0] - [x, y]
    first = np.unwrap(np.arctan2(away[:, 0], -away[:, 1]))
    constants = {"pivot_x": x, "pivot_y": y, "length": radius}
    if options.mechanism == "pendulum":
        angles, text = first[:, None], PENDULUM
        # A mass of 1 at a distance of 1: gravity is the square of the angular frequency.
        crossings = np.flatnonzero(np.diff(np.sign(first - np.mean(first))))
        rate = np.pi / (np.mean(np.diff(crossings)) * dt)
        numbers = {"gravity": (rate**2, 0.1 * rate**2, 10 * rate**2), "across": (0.0, -(rate**2), rate**2)}
        numbers |= {"damping": (0.01, 0.0, 10.0), "dry": (0.01, 0.0, 10.0)}
        size = radius
    else:
        text = DOUBLE
        arm = away / np.linalg.norm(away, axis=1)[:, None]
        second = points[1]

        def off(p: np.ndarray) -> np.ndarray:
            return np.linalg.norm(second - [x, y] - p[0] * arm, axis=1)[:fitted] - p[1]

        link, end = least_squares(off, [1.5 * radius, radius], loss="soft_l1", f_scale=0.02).x
        beyond = second - [x, y] - link * arm
        angle = np.unwrap(np.arctan2(beyond[:, 0], -beyond[:, 1]))
        angles = np.stack([first, angle - first], axis=1)
        constants |= {"length": link, "length_2": end}
        numbers = {
            "gravity": (1.5, 0.1, 20.0),
            "across": (0.0, -2.0, 2.0),
            "damping": (1e-3, 0.0, 1.0),
            "dry": (1e-3, 0.0, 1.0),
            "damping2": (1e-3, 0.0, 1.0),
            "dry2": (1e-3, 0.0, 1.0),
            "com": (0.5 * link, 0.01, 2 * link),
            "inertia": (0.08 * link**2, 1e-4, 1.0),
            "link": (link, 0.5 * link, 2 * link),
            "com2": (end, 0.01, 3 * end),
            "inertia2": (0.08 * end**2, 1e-5, 1.0),
            "mass2": (0.5, 0.01, 10.0),
        }
        size = link + end
    problem = Problem(text, numbers, windows(angles[:fitted], options.windows), dt)
    found = problem.fitted()
    for name, each in found.items():
        if name != "start":
            constants[name] = float(each.value[0])
    if options.mechanism == "pendulum":
        constants["period_in_frames"] = 2 * np.pi / np.hypot(constants["gravity"], constants["across"]) ** 0.5 * fps
    rms = float(np.sqrt(np.mean(problem.residual(found.as_vector(), found)[0][0] ** 2)))
    held = angles[fitted:]
    ahead = Problem(text, {}, held[None, :GIVEN], dt)
    frozen = {name: each.value[0] for name, each in found.items() if name != "start"}
    ahead.text = text.replace("{step}", "@").format_map({k: v for k, v in frozen.items()}).replace("@", "{step}")
    path = ahead.rolled(ahead.fitted(), len(held))[0]
    turned = np.cumsum(path, axis=1)
    places = np.array([x, y]) + constants["length"] * np.stack([np.sin(turned[:, 0]), -np.cos(turned[:, 0])], axis=1)
    seen = np.array([x, y]) + constants["length"] * (away[fitted:] / np.linalg.norm(away[fitted:], axis=1)[:, None])
    errors = np.linalg.norm(places - (points[0][fitted:] if options.mechanism == "pendulum" else seen), axis=1)
    if options.mechanism != "pendulum":
        tip = places + end * np.stack([np.sin(turned[:, 1]), -np.cos(turned[:, 1])], axis=1)
        errors = np.maximum(errors, np.linalg.norm(tip - points[1][fitted:], axis=1))
    share = errors[GIVEN:] / size
    valid = {str(limit): int(np.argmax(np.append(share, np.inf) > limit)) for limit in (0.03, 0.1)}
    try:
        commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True).stdout.strip()
    except OSError:
        commit = "unknown"
    result = {
        "mechanism": options.mechanism,
        "clip": Path(options.clip).stem,
        "commit": commit,
        "clicks": len(clicks),
        "cpu_seconds": round(time.process_time() - began, 1),
        "frames": {"fitted": fitted, "predicted": len(share)},
        "constants": {name: round(float(value), 5) for name, value in constants.items()},
        "fit_rms_rad": round(rms, 5),
        "prediction": {
            "rms": round(float(np.sqrt(np.mean(share**2))), 5),
            "largest": round(float(share.max()), 5),
            "valid_frames": valid,
        },
    }
    print(json.dumps(result, indent=1))
    if options.out is not None:
        options.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
