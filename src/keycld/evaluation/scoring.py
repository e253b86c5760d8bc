"""Score a model on a data set under a protocol, next to the trivial baselines."""

import dataclasses
from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from keycld._errors import KeycldError
from keycld.drawing import as_uint8
from keycld.evaluation.baselines import baseline_predictions
from keycld.evaluation.drift import constraint_drift, energy_drift
from keycld.evaluation.image_scores import all_errors, image_scores
from keycld.evaluation.observing import probed_system, score_states
from keycld.evaluation.outcome import Evaluation, keypoint_names
from keycld.evaluation.predicting import Progress, batch_size, free_motion, observe, predict, refuse_too_few
from keycld.evaluation.protocols import Protocol
from keycld.evaluation.reading import windows
from keycld.evaluation.reference_images import References, references
from keycld.models.base import AbstractModel, HasKeypoints, HasLagrangian, Reversible

if TYPE_CHECKING:
    from keycld.data import DataSet

_SHOWN_FRAMES = 250


def evaluate(
    model: AbstractModel,
    data: "DataSet",
    protocol: Protocol,
    *,
    shared: References | None = None,
    progress: Progress | None = None,
) -> Evaluation:
    """Predict trajectories of the protocol's split from the given frames and the inputs, and score the frames.

    True states reach the probe and the constant-acceleration baseline, never the model. Pictures pass in blocks, so
    memory does not grow with the number of trajectories.

    Args:
        model: any model; results that it has no means for (keypoints, energies) are left out.
        data: where the split, the validation set (ε, probe) and the training set (baselines) are.
        protocol: what is given and scored.
        shared: `references(data)`, to read them once for several protocols.
        progress: called with the number of frames predicted and their total.

    Returns:
        `scores`: `vpt` and `baselines` (each with one summary a threshold), `mse`, `epsilon`, `state` (probe), `drift`,
            `masses`, `frames_passed` through the networks, …
        `arrays`: `mse [N, T]`, `baseline_mse_*`, and how the first trajectories looked.

    Raises:
        KeycldError: the split has no pictures or too few frames; the model needs more given frames, or cannot run
            backward.
    """
    refuse_too_few(model, protocol.given)
    if protocol.backward and not isinstance(model, Reversible):
        raise KeycldError(f"protocol '{protocol.name}' predicts the past, but this model cannot run backward.")
    shared = shared or references(data)
    system = probed_system(data, shared, protocol.split) if isinstance(model, HasKeypoints) else None
    done = _pass(model, data, protocol, shared, progress, with_states=system is not None)
    count = len(done.errors["mse"])
    few = slice(0, min(protocol.shown, count))
    arrays = {
        **done.errors,
        **done.shown,
        "time": done.dt * np.arange(protocol.horizon),
        "shown_index": np.arange(0, protocol.horizon, _stride(protocol)),
        **{name: value[few] for name, value in done.along.items()},
        **{f"free_{name}": value[few] for name, value in done.free.items()},
    }
    for name, errors in done.baselines.items():
        arrays |= {f"baseline_{kind}_{name.replace(' ', '_')}": value for kind, value in errors.items()}
    scores: dict[str, Any] = {
        "protocol": dataclasses.asdict(protocol),
        "system": data.system,
        "n": count,
        "dt": done.dt,
        "metric": protocol.metric,
        "direction": protocol.direction,
        "part": list(protocol.part),
        "epsilon": shared.epsilon,
        "threshold": protocol.limit(protocol.thresholds[0], shared.epsilon),
        "references": shared.sources,
        **image_scores(done.errors, shared.epsilon, protocol, per_trajectory=True),
        "baselines": {name: image_scores(errors, shared.epsilon, protocol) for name, errors in done.baselines.items()},
    }
    _add_drift(scores, arrays, done)
    if isinstance(model, HasLagrangian):
        # Sums of rows of M: of a law without constraints that couples keypoints one may be negative, and is no mass.
        masses = np.asarray(model.law.masses)
        if np.all(masses > 0):
            scores["masses"] = masses.tolist()
    passed = count * (protocol.given + protocol.horizon)
    if isinstance(model, HasKeypoints):
        keypoints = done.along["keypoints"]
        scores["keypoints"] = list(keypoint_names(data.keypoints, keypoints.shape[2]))
        passed += _add_observations(arrays, model)
        if system is not None:
            assert done.states is not None
            # From the given end on, so that errors at the last frame are those of the longest prediction.
            order = slice(None, None, -1 if protocol.backward else 1)
            rolled, scored = (keypoints[:, order], done.states[:, order]), (protocol.split, protocol.trajectories)
            scores["state"], curves, frames = score_states(model, data, system, shared, scored, rolled)
            arrays |= {name: curve[:, order] for name, curve in curves.items()}
            passed += frames
    scores["frames_passed"] = passed
    return Evaluation(scores, arrays)


@dataclass(frozen=True)
class _Pass:
    """What one pass over all trajectories leaves, joined along them.

    Attributes:
        dt: seconds between frames.
        errors: frame errors `[N, T]` by the name of their array.
        baselines: the same by the name of the trivial predictor.
        along: keypoints and mechanical quantities along the predictions.
        free: mechanical quantities without input.
        states: true states of the window `[N, T, d]`, where the probe wants them.
        shown: pictures and inputs of the first trajectories.
    """

    dt: float
    errors: dict[str, np.ndarray]
    baselines: dict[str, dict[str, np.ndarray]]
    along: dict[str, np.ndarray]
    free: dict[str, np.ndarray]
    states: np.ndarray | None
    shown: dict[str, np.ndarray]


def _pass(
    model: AbstractModel,
    data: "DataSet",
    protocol: Protocol,
    shared: References,
    progress: Progress | None,
    *,
    with_states: bool,
) -> _Pass:
    """Predict all trajectories, a block at a time, and keep what is small."""
    horizon, first, dt = protocol.horizon, protocol.first_given, 0.0
    count = data.count(protocol.split)
    count = min(count, protocol.trajectories or count)
    batch, stride = min(count, batch_size(horizon)), _stride(protocol)
    errors, along, free, states, shown = [], [], [], [], []
    baselines: dict[str, list[dict[str, np.ndarray]]] = defaultdict(list)
    for rows, window in windows(data, protocol, batch):
        truth, u, dt = window.image, window.input, window.dt
        assert truth is not None
        given = truth[:, first : first + protocol.given]
        for part, predicted in predict(model, given, dt, u, horizon, first=first, batch=batch):
            errors.append(all_errors(protocol, truth[part], predicted.frames))
            keypoints = {} if predicted.keypoints is None else {"keypoints": predicted.keypoints}
            along.append({**predicted.mechanics, **keypoints})
            few = slice(part.start, min(part.stop, max(part.start, protocol.shown - rows.start)))
            pictures = as_uint8(predicted.frames[: few.stop - few.start, ::stride])
            shown.append({"prediction": pictures, "truth": truth[few, ::stride].copy(), "u": u[few]})
            if progress is not None:
                progress((rows.start + part.stop) * horizon, count * horizon)
        if with_states:
            states.append(window.state)
        # What a motion without input keeps does not depend on the direction in which a protocol predicts.
        free.append({} if protocol.backward else free_motion(model, given, dt, u, horizon - 1, batch=batch))
        for name, prediction in baseline_predictions(window, protocol, shared):
            baselines[name].append(all_errors(protocol, truth, prediction))
    return _Pass(
        dt=dt,
        errors=_joined(errors),
        baselines={name: _joined(parts) for name, parts in baselines.items()},
        along=_joined(along),
        free=_joined(free),
        states=np.concatenate(states) if with_states else None,
        shown=_joined(shown),
    )


def _joined(parts: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _stride(protocol: Protocol) -> int:
    """Return the step between the frames that are shown."""
    return -(-protocol.horizon // _SHOWN_FRAMES)


def _add_drift(scores: dict[str, Any], arrays: dict[str, np.ndarray], done: _Pass) -> None:
    """Add the drift of what the model knows: energies without input, constraints along the predictions."""
    drift = {}
    if "kinetic" in done.free:
        drift["energy"], arrays["energy_drift"] = energy_drift(done.free["kinetic"], done.free["potential"])
    if "deviation" in done.along:
        drift["constraint"] = constraint_drift(done.along["deviation"])
    if drift:
        scores["drift"] = drift


def _add_observations(arrays: dict[str, np.ndarray], model: HasKeypoints) -> int:
    """Add what the encoder observes in the shown true frames, and return how many these are."""
    truth = arrays["truth"]
    if len(truth) == 0:
        return 0
    keypoints, heat_maps = observe(model, truth.reshape(-1, *truth.shape[2:]), heat_maps=True)
    arrays["observed_keypoints"] = keypoints.reshape(*truth.shape[:2], -1, 2)
    if heat_maps is not None:
        arrays["heat_maps"] = heat_maps.reshape(*truth.shape[:2], *heat_maps.shape[1:])
    return len(keypoints)
