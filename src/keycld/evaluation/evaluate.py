"""Score a model on a data set under a protocol, with the trivial baselines beside it."""

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from keycld._errors import KeycldError
from keycld.drawing import as_uint8
from keycld.evaluation.baselines import References, baseline_errors, references
from keycld.evaluation.drift import constraint_drift, energy_drift
from keycld.evaluation.metrics import frame_errors, statistics, valid_prediction_time
from keycld.evaluation.predicting import Progress, free_motion, law_of, observe, predict
from keycld.evaluation.probe import fit_probe, probe_scores
from keycld.evaluation.protocols import Protocol
from keycld.models.base import AbstractModel

if TYPE_CHECKING:
    from keycld.data import DataSet, Trajectories

_PROBE_FRAMES = 1000
_SHOWN_FRAMES = 250


@dataclass(frozen=True)
class Evaluation:
    """The outcome of one protocol: `scores` as JSON would hold them, `arrays` for the figures.

    `docs/evaluation.md` lists both.
    """

    scores: dict[str, Any]
    arrays: dict[str, np.ndarray]


def evaluate(
    model: AbstractModel,
    data: "DataSet",
    protocol: Protocol,
    *,
    shared: References | None = None,
    progress: Progress | None = None,
) -> Evaluation:
    """Predict every trajectory of the protocol's split from its first frames and inputs, and score the
    frames.

    True states reach the probe and the constant-acceleration baseline, never the model.

    Args:
        model: any model; figures that it has no means for (keypoints, energies) are left out.
        data: where the split, the validation set (ε, probe) and the training set (baselines) are.
        protocol: what is given and scored.
        shared: `references(data)`, to read them once for several protocols.
        progress: called with the number of frames predicted and their total.

    Returns:
        `scores`: `vpt` and `baselines` (each with one summary a threshold factor), `mse`, `epsilon`,
            `state` (probe), `drift`, `masses`, `frames_passed` through the networks, …
        `arrays`: `mse [N, T]`, `baseline_mse_*`, and what the first trajectories looked like.

    Raises:
        KeycldError: the split has no pictures or too few frames, or the model needs more given frames.
    """
    trajectories = data.split(protocol.split)
    if trajectories.image is None or trajectories.image.shape[1] < protocol.horizon:
        found = "no /image" if trajectories.image is None else f"{trajectories.image.shape[1]} frames"
        raise KeycldError(
            f"protocol '{protocol.name}' scores {protocol.horizon} frames of {protocol.split}.h5, "
            f"which has {found}: choose another protocol or make the file with more."
        )
    shared = shared or references(data)
    truth = trajectories.image[:, : protocol.horizon]
    count, horizon = truth.shape[:2]
    dt = float(trajectories.attributes["dt"])
    stride = -(-horizon // _SHOWN_FRAMES)

    arrays: dict[str, Any] = {}
    errors, shown, series = [], [], []
    for part, found in predict(model, truth[:, : protocol.given], dt, trajectories.input, horizon, progress):
        errors.append(frame_errors(truth[part], found.frames))
        shown.append(as_uint8(found.frames[: max(0, protocol.shown - part.start), ::stride]))
        series.append(found.mechanics if found.keypoints is None else {**found.mechanics, "keypoints": found.keypoints})
    arrays["mse"] = np.concatenate(errors)
    arrays["prediction"] = np.concatenate(shown)
    predicted = {name: np.concatenate([found[name] for found in series]) for name in series[0]}
    free = {
        name: np.asarray(value)
        for name, value in free_motion(model, truth[:, : protocol.given], dt, trajectories.input, horizon - 1).items()
    }
    passed = count * (protocol.given + horizon)

    few = slice(0, min(protocol.shown, count))
    arrays |= {
        "truth": truth[few, ::stride],
        "time": dt * np.arange(horizon),
        "shown_index": np.arange(0, horizon, stride),
        "u": trajectories.input[few],
    }
    arrays |= {name: value[few] for name, value in predicted.items()}
    arrays |= {f"free_{name}": value[few] for name, value in free.items()}
    for name, value in baseline_errors(trajectories, horizon, protocol.given, shared).items():
        arrays[f"baseline_mse_{name.replace(' ', '_')}"] = value

    scores: dict[str, Any] = {
        "protocol": dataclasses.asdict(protocol),
        "system": data.system,
        "n": count,
        "dt": dt,
        "epsilon": shared.epsilon,
        **_image_scores(arrays["mse"], shared.epsilon, protocol, per_trajectory=True),
        "baselines": {
            name.removeprefix("baseline_mse_").replace("_", " "): _image_scores(value, shared.epsilon, protocol)
            for name, value in arrays.items()
            if name.startswith("baseline_mse_")
        },
    }
    if "kinetic" in free:
        drift, arrays["energy_drift"] = energy_drift(free["kinetic"], free["potential"])
        scores["drift"] = {"energy": drift}
        if "deviation" in predicted:
            scores["drift"]["constraint"] = constraint_drift(predicted["deviation"])
        scores["masses"] = np.asarray(law_of(model).masses).tolist()  # pyright: ignore
    if "keypoints" in predicted:
        scores["keypoints"] = _names(data, predicted["keypoints"].shape[2])
        watched = observe(model, arrays["truth"].reshape(-1, *truth.shape[2:]), heat_maps=True)
        assert watched is not None
        arrays["observed_keypoints"] = watched[0].reshape(*arrays["truth"].shape[:2], -1, 2)
        if watched[1] is not None:
            arrays["heat_maps"] = watched[1].reshape(*arrays["truth"].shape[:2], *watched[1].shape[1:])
        passed += len(watched[0])
        state = _probe(model, data, trajectories, predicted["keypoints"], shared)
        if state is not None:
            scores["state"], found, frames = state
            arrays |= found
            passed += frames
    scores["frames_passed"] = passed
    return Evaluation(scores, arrays)


def _names(data: "DataSet", count: int) -> list[str]:
    """Names of the model's keypoints; numbers where the data set names others or none."""
    try:
        names = list(data.keypoints)
    except KeycldError:
        names = []
    return names if len(names) == count else [f"keypoint {k + 1}" for k in range(count)]


def _image_scores(
    errors: np.ndarray, epsilon: float, protocol: Protocol, per_trajectory: bool = False
) -> dict[str, Any]:
    """MSE and, for each threshold factor, VPT divided by T."""
    vpt = {}
    for factor in protocol.factors:
        frames = valid_prediction_time(errors, factor * epsilon)
        vpt[f"{factor:g}"] = statistics(frames / errors.shape[1])
        if per_trajectory:
            vpt[f"{factor:g}"]["frames"] = frames.tolist()
    return {"mse": float(np.mean(errors)), "vpt": vpt}


def _probe(
    model: AbstractModel,
    data: "DataSet",
    trajectories: "Trajectories",
    predicted: np.ndarray,
    shared: References,
) -> tuple[dict[str, Any], dict[str, np.ndarray], int] | None:
    """Probe scores, curves and the number of frames encoded; None without states or a known system."""
    from keycld import systems

    validation = data.validation()
    if data.system not in systems.names() or not systems.get(data.system).keypoints:
        return None
    if shared.states is None or shared.angles is None:
        return None
    if trajectories.state is None or validation.state is None:
        return None
    fit, seen = (_watch(model, split) for split in (validation, trajectories))
    guesses = shared.states[:: max(1, len(shared.states) // 2000)]
    probe = fit_probe(systems.get(data.system), *fit, guesses, shared.angles)
    truth = trajectories.state[:, : predicted.shape[1]]
    scores, arrays = probe_scores(probe, fit, seen, (predicted, truth))
    return scores, arrays, len(fit[0]) + len(seen[0])


def _watch(model: AbstractModel, trajectories: "Trajectories") -> tuple[np.ndarray, np.ndarray]:
    """Keypoints seen in about a thousand frames, spread over all trajectories, and their true states."""
    assert trajectories.image is not None and trajectories.state is not None
    total = trajectories.image.shape[0] * trajectories.image.shape[1]
    # A stride without a common factor with the length of a trajectory visits all times of it.
    stride = max(1, total // _PROBE_FRAMES)
    while np.gcd(stride, trajectories.image.shape[1]) > 1:
        stride += 1
    picked = np.arange(0, total, stride)
    n, t = np.divmod(picked, trajectories.image.shape[1])
    seen = observe(model, trajectories.image[n, t])
    assert seen is not None
    return seen[0], trajectories.state[n, t]
