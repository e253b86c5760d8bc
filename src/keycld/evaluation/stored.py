"""What a stored result must hold: types of the scores, kinds and dimensions of the arrays."""

from collections.abc import Mapping
from typing import Any, Literal, NotRequired, TypedDict

import numpy as np

from keycld._files import checked_name
from keycld._records import Name, NumberText, Unexpected, checked
from keycld.evaluation.image_scores import ERROR_ARRAYS

Number = float | None
_MOTIONS = ("observed", "predicted")
# What is stored along a motion, all or nothing.
_ALONG = ("kinetic", "potential", "course")
# Of what lies along an axis of a figure.
_LARGEST = 1e9


class _Protocol(TypedDict):
    name: Name
    split: Name
    horizon: int
    given: int
    start: NotRequired[int]


class _Vpt(TypedDict):
    mean: float
    std: float
    median: float
    interval: tuple[float, float]
    frames: NotRequired[list[int]]


class _Baseline(TypedDict):
    vpt: dict[NumberText, _Vpt]
    mse: Number
    normalised_error: NotRequired[dict[str, Number]]
    table_units: NotRequired[dict[str, Number]]


class _Coordinate(TypedDict):
    name: str
    unit: str
    last_median: Number


class _State(TypedDict):
    landmarks: list[str]
    residual: float
    rollout: Number
    rollout_last: Number
    coordinates: list[_Coordinate]


class _Drift(TypedDict):
    mean: Number
    worst: Number


class _Drifts(TypedDict):
    energy: NotRequired[_Drift]
    constraint: NotRequired[_Drift]


class _Scores(_Baseline):
    protocol: _Protocol
    n: int
    dt: float
    metric: Literal["squared", "normalised"]
    direction: Literal["forward", "backward"]
    part: tuple[int, int]
    epsilon: float
    threshold: float
    baselines: dict[str, _Baseline]
    masses: NotRequired[list[float]]
    keypoints: NotRequired[list[str]]
    state: NotRequired[_State]
    drift: NotRequired[_Drifts]


class _Disturbance(TypedDict):
    noise: float
    dropped: float


class _Step(TypedDict):
    median_ms: float
    p99_ms: float
    period_ms: float
    missed: int
    frames: int


class _Passivity(TypedDict):
    largest_rise_median: Number
    falling_frames: Number


class _Control(TypedDict):
    law: str
    limit: Number
    estimator: str
    disturbance: _Disturbance
    goal: str
    inputs: list[str]
    acting: list[str]
    dt: float
    n: int
    successes: int
    settled_seconds: list[Number]
    largest_input: list[Number]
    mean_mass: Number
    step: _Step
    passivity: NotRequired[_Passivity]


class _Errors(TypedDict):
    rms: Number
    largest: Number
    end: Number


class _Followed(TypedDict):
    error: _Errors
    valid: dict[NumberText, float]


class _Residual(TypedDict):
    residual: float
    largest: float


class _Link(TypedDict):
    label: str
    keypoints: list[str]
    point: tuple[float, float] | None


class _Motion(_Followed):
    split: Name
    n: int
    frames: int
    given: int
    dt: float
    size: float
    pixel: float
    keypoints: list[str]
    links: list[_Link]
    baselines: dict[str, _Followed]
    skeleton: dict[str, _Residual]


def checked_scores(scores: dict[str, Any]) -> dict[str, Any]:
    """Return the scores of a protocol, a closed-loop run or a motion, if they are complete; sweeps have none.

    Raises:
        Unexpected: an entry is missing or of another type.
    """
    if "law" in scores:
        found = checked(scores, _Control)
        _expect(found["dt"] > 0 and len(found["settled_seconds"]) == found["n"] > 0, "trials")
        return found
    if "skeleton" in scores:
        found = checked(scores, _Motion)
        _expect(found["dt"] > 0 and found["n"] > 0 and 0 < found["given"] < found["frames"], "frames")
        _expect(found["size"] > 0 and found["pixel"] > 0, "size")
        known = {name for link in found["links"] for name in link["keypoints"]}
        _expect(known <= set(found["keypoints"]), "links")
        return found
    if "protocol" not in scores:
        return scores
    found = checked(scores, _Scores)
    (first, stop), horizon, thresholds = found["part"], found["protocol"]["horizon"], found["vpt"]
    _expect(0 <= first < stop <= horizon and found["dt"] > 0 and found["n"] > 0, "frames")
    _expect(bool(thresholds) and len(next(iter(thresholds.values())).get("frames", ())) == found["n"], "vpt")
    _expect(all(each["vpt"].keys() == thresholds.keys() for each in found["baselines"].values()), "baselines")
    _expect(bool(found["baselines"]) and all(mass > 0 for mass in found.get("masses", ())), "masses")
    masses, keypoints = found.get("masses"), found.get("keypoints")
    _expect(masses is None or keypoints is None or len(masses) == len(keypoints), "keypoints")
    if found["metric"] == "normalised":
        _expect("normalised_error" in found and "table_units" in found, "normalised_error")
    return found


def _expect(holds: object, what: object) -> None:
    if not holds:
        raise Unexpected(f"the numbers of '{what}' do not fit the others")


def layout(scores: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """Return kinds and dimensions of the arrays next to these scores, as `read_arrays` takes them."""
    if "law" in scores:
        n, inputs = scores["n"], len(scores["inputs"])
        return {
            "frames": ("u", "F H W 3"),
            "goal_frame": ("u", "H W 3"),
            "x": ("f", f"{n} T K2"),
            "good": ("b", f"{n} T"),
            "input": ("f", f"{n} T {inputs}"),
            "tilts": ("f", f"{n} F links"),
            "kinetic": ("f", f"{n} T"),
            "desired": ("f", f"{n} T"),
        }
    if "skeleton" in scores:
        n, length, keypoints = scores["n"], scores["frames"], len(scores["keypoints"])
        along = {"kinetic": ("f", f"{length}"), "potential": ("f", f"{length}"), "course": ("f", f"{length} c 2")}
        return {
            "frames": ("u", "F H W 3"),
            "shown_index": ("i", "F"),
            **{kind: ("f", f"{n} {length}") for kind in _motion_errors(scores)},
            **{motion: ("f", f"{length} {keypoints} 2") for motion in _MOTIONS},
            **{f"{motion}_{name}": shape for motion in _MOTIONS for name, shape in along.items()},
        }
    if "protocol" not in scores:
        return {}
    n, horizon = scores["n"], scores["protocol"]["horizon"]
    errors = {name: ("f", f"{n} {horizon}") for name in _error_arrays(scores)}
    coordinates = len(scores["state"]["coordinates"]) if "state" in scores else "m"
    return errors | {
        "truth": ("u", "shown F H W 3"),
        "prediction": ("u", "shown F H W 3"),
        "u": ("f", "shown ..."),
        "shown_index": ("i", "F"),
        "time": ("f", f"{horizon}"),
        "keypoints": ("f", f"_ {horizon} K 2"),
        "observed_keypoints": ("f", "shown F K 2"),
        "heat_maps": ("uf", "shown F K _ _"),
        "coordinate_error": ("f", f"{n} {horizon} {coordinates}"),
        "free_kinetic": ("f", f"free {horizon}"),
        "free_potential": ("f", f"free {horizon}"),
        "deviation": ("f", f"_ {horizon}"),
    }


def _error_arrays(scores: Mapping[str, Any]) -> list[str]:
    kind = ERROR_ARRAYS[scores["metric"]]
    return [kind, *(f"baseline_{kind}_{name.replace(' ', '_')}" for name in scores["baselines"])]


def _motion_errors(scores: Mapping[str, Any]) -> list[str]:
    return ["error", *(f"error_{name.replace(' ', '_')}" for name in scores["baselines"])]


def required(scores: Mapping[str, Any]) -> set[str]:
    """Return the names of the arrays that must be next to these scores."""
    if "law" in scores:
        shaped = {"kinetic", "desired"} if "passivity" in scores else set()
        return {"frames", "goal_frame", "x", "good", "input", "tilts", *shaped}
    if "skeleton" in scores:
        return {"frames", "shown_index", *_motion_errors(scores), *_MOTIONS}
    if "protocol" not in scores:
        return set()
    also = {"coordinate_error"} if "state" in scores else set()
    also |= {"free_kinetic", "free_potential"} if "energy" in scores.get("drift", {}) else set()
    return {*_error_arrays(scores), "truth", "prediction", "u", "shown_index", "time", *also}


def check_arrays(scores: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    """Refuse arrays whose values lead out of others, or sweeps that are not complete.

    Raises:
        Unexpected: says which.
    """
    for name in layout(scores).keys() & arrays.keys():
        _expect(len(arrays[name]) > 0, name)
    if "protocol" in scores:
        index, horizon = arrays["shown_index"], scores["protocol"]["horizon"]
        whole = len(index) > 1 and index.min() >= 0 and index.max() < horizon and np.all(np.diff(index) > 0)
        _expect(bool(whole) and len(arrays["truth"]) > 0, "shown_index")
        _expect(np.all(np.abs(arrays["time"]) < _LARGEST), "time")
    elif "skeleton" in scores:
        index = arrays["shown_index"]
        _expect(len(index) > 0 and index.min() >= 0 and index.max() < scores["frames"], "shown_index")
        for motion in _MOTIONS:
            along = {f"{motion}_{name}" for name in _ALONG}
            _expect(along <= arrays.keys() or not along & arrays.keys(), f"{motion}_course")
    elif "law" in scores:
        _expect(len(arrays["frames"]) == arrays["input"].shape[1] + 1 > 1 and arrays["x"].shape[2] % 2 == 0, "frames")
    elif arrays:
        _check_sweeps(arrays)


def _check_sweeps(arrays: Mapping[str, np.ndarray]) -> None:
    lists = [arrays[name] for name in ("names", "vary", "units")]
    _expect(all(each.ndim == 1 and each.dtype.kind == "U" for each in lists), "names")
    _expect(len({len(each) for each in lists}) == 1, "names")
    for name, vary, units in zip(*lists, strict=True):
        checked_name(str(name), "the array 'names'")
        count = len(str(vary).split(","))
        parts = {part: arrays[f"{name}/{part}"] for part in ("values", "shape", "potential", "keypoints", "image")}
        n = len(parts["potential"])
        _expect(count == len(str(units).split(",")) <= 2 and parts["values"].shape == (n, count) and n > 1, name)
        _expect(parts["potential"].shape == (n,) and parts["keypoints"].shape[::2] == (n, 2), name)
        _expect(parts["image"].dtype == np.uint8 and parts["image"].ndim == 4 and len(parts["image"]) == n, name)
        _expect(parts["shape"].shape == (count,) and parts["shape"].dtype.kind in "iu", name)
        _expect(int(np.prod(parts["shape"], dtype=float)) == n and min(parts["shape"]) > 0, name)
        _expect(all(parts[each].dtype.kind == "f" for each in ("values", "potential", "keypoints")), name)
        _expect(np.all(np.abs(parts["values"]) < _LARGEST), name)
        _expect(parts["keypoints"].ndim == 3 and parts["image"].shape[-1] == 3, name)
