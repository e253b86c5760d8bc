"""How a clip's motion was followed and predicted: keypoints, skeleton, energies, next to motions without physics."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.data import before_test
from keycld.evaluation.metrics import valid_prediction_time
from keycld.evaluation.outcome import Evaluation, keypoint_names
from keycld.evaluation.predicting import Progress, batch_size, observe, predict, refuse_too_few
from keycld.mechanics import AbstractDisplacement, Constraints, Motion, State
from keycld.models.base import AbstractModel, HasKeypoints, HasLagrangian
from keycld.vision import pixel_size

if TYPE_CHECKING:
    from keycld.data import DataSet

MOTION = "motion"
"""Name of the result."""
GIVEN = 10
"""Frames from which the rest of a recording is predicted."""
LIMITS = (0.03, 0.1)
"""Errors, as shares of the size of the mechanism, up to which a prediction counts as valid."""
_SMOOTHED = 7
_SHOWN = 400


def evaluate_motion(
    model: AbstractModel, data: "DataSet", *, split: str = "test", given: int = GIVEN, progress: Progress | None = None
) -> Evaluation:
    """Predict each recording of a split to its end from its first frames, and compare keypoints with the observed ones.

    The error of a frame is the largest distance of a keypoint from the observed one. The size of the mechanism is the
    sum of its constant distances, without any the largest extent of the motion. The residual of a constraint is the
    root mean square deviation of a distance, or of the distance from a line, from its mean over the training frames, in
    all frames of all splits. Predictions of constant velocity and of constant acceleration are least-squares
    polynomials through the keypoints in the same given frames.

    Args:
        model: with keypoints and a Lagrangian.
        data: of which train, validation and the split are read.
        split: the recordings that are predicted.
        given: frames that are given of each.
        progress: called with the number of frames predicted and their total.

    Returns:
        `scores`: `size`, `pixel` (image-plane units), `error`, `valid`, `baselines`, `skeleton`; see `docs/watch.md`.
        `arrays`: frames and keypoints of the first recording of the split, observed and predicted; errors; angles and
            rates; energies.

    Raises:
        KeycldError: the model has no keypoints or no Lagrangian, needs more given frames, or there are none to predict.
    """
    if not (isinstance(model, HasKeypoints) and isinstance(model, HasLagrangian)):
        raise KeycldError("motions are compared by keypoints and energies, which this model does not have.")
    refuse_too_few(model, given)
    held = data.split(split)
    assert held.image is not None
    count, length, dt = len(held), held.frames, held.dt
    if length <= given:
        raise KeycldError(f"recordings of {length} frames leave nothing to predict after {given} given ones.")
    observed = _observed(model, held.image)
    others = [_observed(model, data.split(name).image) for name in ("train", "validation") if name != split]
    train = others[0] if split != "train" else observed
    everything = np.concatenate([each.reshape(-1, *each.shape[2:]) for each in (*others, observed)])
    skeleton, size = _skeleton(model, train.reshape(-1, *train.shape[2:]), everything)
    predicted = np.concatenate(
        [
            np.asarray(found.keypoints)
            for _, found in predict(
                model, held.image[:, :given], dt, held.input, length, progress, batch=min(count, batch_size(length))
            )
        ]
    )
    error = _distance(predicted, observed) / size
    baselines = {
        name: _distance(polynomial(observed[:, :given], length, degree), observed) / size
        for name, degree in (("constant velocity", 1), ("constant acceleration", 2))
    }
    height, width = held.image.shape[2:4]
    scores: dict[str, Any] = {
        "split": split,
        "n": count,
        "frames": length,
        "given": given,
        "dt": dt,
        "size": size,
        "pixel": pixel_size(height, width),
        "keypoints": list(_names(model, observed.shape[2])),
        "links": _links(model),
        "error": summary(error[:, given:]),
        "valid": valid_frames(error, given),
        "baselines": {
            name: {"error": summary(each[:, given:]), "valid": valid_frames(each, given)}
            for name, each in baselines.items()
        },
        "skeleton": skeleton,
    }
    stride = -(-length // _SHOWN)
    arrays = {
        "shown_index": np.arange(0, length, stride),
        "frames": held.image[0, ::stride],
        "observed": observed[0],
        "predicted": predicted[0],
        "error": error,
        **{f"error_{name.replace(' ', '_')}": each for name, each in baselines.items()},
    }
    seen, ahead = _course(model, observed[0], dt), _course(model, predicted[0], dt)
    if seen and ahead:
        ahead["course"] = _beside(model, ahead["course"], seen["course"])
    for name, found in (("observed", seen), ("predicted", ahead)):
        arrays |= {f"{name}_{kind}": value for kind, value in found.items()}
    return Evaluation(scores, arrays)


def fitted_tracks(model: HasKeypoints, data: "DataSet") -> tuple[Float[np.ndarray, "N T dim"], np.ndarray]:
    """Return the keypoints observed in the recordings before the test part (`before_test`), and their inputs."""
    fitted = before_test(data)
    x = _observed(model, fitted.image)
    return x.reshape(*x.shape[:2], -1), fitted.input


def polynomial(given: Float[np.ndarray, "N n K 2"], length: int, degree: int) -> Float[np.ndarray, "N T K 2"]:
    """Return the continuation of given keypoints to `length` frames by the least-squares polynomial through them."""
    count, n, keypoints, _ = given.shape
    flat = given.transpose(1, 0, 2, 3).reshape(n, -1).astype(float)
    powers = (np.arange(length) / n)[:, None] ** np.arange(degree + 1)
    coefficients = np.linalg.lstsq(powers[:n], flat, rcond=None)[0]
    return (powers @ coefficients).reshape(length, count, keypoints, 2).transpose(1, 0, 2, 3)


def summary(error: Float[np.ndarray, "N T"]) -> dict[str, float]:
    """Return the root mean square and the largest of errors, and the mean of their last tenth."""
    last = error[:, -max(1, error.shape[1] // 10) :]
    return {"rms": float(np.sqrt(np.mean(error**2))), "largest": float(np.max(error)), "end": float(np.mean(last))}


def valid_frames(error: Float[np.ndarray, "N T"], given: int) -> dict[str, float]:
    """Return after how many predicted frames the error first exceeds each of `LIMITS`: the mean over recordings."""
    part = given, error.shape[1]
    return {f"{limit:g}": float(np.mean(valid_prediction_time(error, limit, part=part))) for limit in LIMITS}


def _observed(model: HasKeypoints, image: Any) -> Float[np.ndarray, "N T K 2"]:
    found, _ = observe(model, image.reshape(-1, *image.shape[2:]))
    return found.reshape(*image.shape[:2], *found.shape[1:]).astype(float)


def _distance(one: np.ndarray, other: np.ndarray) -> Float[np.ndarray, "N T"]:
    """Return the largest distance between keypoints of a frame; one that is not finite is very far."""
    return np.nan_to_num(np.linalg.norm(one - other, axis=-1), nan=1e6, posinf=1e6).max(axis=-1)


def _relations(model: HasLagrangian) -> tuple[AbstractDisplacement, ...]:
    phi = model.law.constraint_function
    items = phi.items if isinstance(phi, Constraints) else ()
    return tuple(item for item in items if isinstance(item, AbstractDisplacement))


def _names(model: HasLagrangian, count: int) -> tuple[str, ...]:
    phi = model.law.constraint_function
    return keypoint_names(phi.keypoints if isinstance(phi, Constraints) else (), count)


def _label(item: AbstractDisplacement) -> str:
    if item.normal is not None:
        return f"line of {item.keypoints[0]}"
    return "–".join(item.keypoints if len(item.keypoints) > 1 else ("pivot", *item.keypoints))


def _along(model: HasLagrangian, points: np.ndarray) -> Float[np.ndarray, "n T 2"]:
    """Return the vector of each relation in each frame: from its point, or its first keypoint, to its last keypoint."""
    names, found = _names(model, points.shape[1]), []
    for item in _relations(model):
        signs = np.array([item.signs.get(name, 0.0) for name in names])
        y = np.einsum("k,tkc->tc", signs, points) - np.asarray(item.origin({}), float)
        found.append(-y if len(item.keypoints) > 1 else y)
    return np.stack(found) if found else np.zeros((0, len(points), 2))


def _values(model: HasLagrangian, points: np.ndarray) -> list[np.ndarray]:
    """Return the distance, or the distance along the normal of a line, of each relation in each frame."""
    return [
        np.linalg.norm(y, axis=1) if item.normal is None else y @ np.asarray(item.normal, float)
        for item, y in zip(_relations(model), _along(model, points), strict=True)
    ]


def _skeleton(model: HasLagrangian, train: np.ndarray, everything: np.ndarray) -> tuple[dict[str, Any], float]:
    """Return the residual of each constraint as a share of its length, or of the size, and the size."""
    means = [float(np.mean(value)) for value in _values(model, train)]
    lengths = [mean for item, mean in zip(_relations(model), means, strict=True) if item.normal is None]
    size = sum(lengths) or float(np.max(np.ptp(train.reshape(len(train), -1), axis=0)))
    found = {}
    for item, value, mean in zip(_relations(model), _values(model, everything), means, strict=True):
        off = np.abs(value - mean) / (mean if item.normal is None else size)
        found[_label(item)] = {"residual": float(np.sqrt(np.mean(off**2))), "largest": float(np.max(off))}
    return found, size


def _links(model: HasLagrangian) -> list[dict[str, Any]]:
    """Return what to plot between keypoints: the two ends of each rigid link, a keypoint's name or a point."""
    found = []
    for item in _relations(model):
        if item.normal is None:
            ends = list(item.keypoints)
            point = None if len(ends) > 1 else [float(p) for p in np.asarray(item.origin({}), float)]
            found.append({"label": _label(item), "keypoints": ends, "point": point})
    return found


def _course(model: HasLagrangian, points: Float[np.ndarray, "T K 2"], dt: float) -> dict[str, np.ndarray]:
    """Return coordinates and rates of a motion, one pair a constraint, and its energies."""
    if not np.all(np.isfinite(points)):
        return {}
    x, v = _smooth(points.reshape(len(points), -1), dt)
    at, rate = [], []
    along, moving = _along(model, x.reshape(points.shape)), _along(model, (x + v * dt).reshape(points.shape))
    for item, y, later in zip(_relations(model), along, moving, strict=True):
        step = (later - y) / dt
        if item.normal is None:
            # From hanging straight down, counter-clockwise.
            at.append(np.unwrap(np.arctan2(y[:, 0], -y[:, 1])))
            rate.append((y[:, 0] * step[:, 1] - y[:, 1] * step[:, 0]) / np.maximum(np.sum(y**2, axis=1), 1e-9))
        else:
            tangent = np.array([item.normal[1], -item.normal[0]], float)
            at.append(y @ tangent)
            rate.append(step @ tangent)
    kinetic, potential = _energies(model, jnp.asarray(x, jnp.float32), jnp.asarray(v, jnp.float32))
    return {
        "course": np.stack([np.stack(at, -1), np.stack(rate, -1)], -1) if at else np.zeros((len(x), 0, 2)),
        "kinetic": np.asarray(kinetic, float),
        "potential": np.asarray(potential, float),
    }


def _beside(model: HasLagrangian, course: np.ndarray, observed: np.ndarray) -> Float[np.ndarray, "T n 2"]:
    """Return a course whose angles are shifted by whole turns, so that they begin nearest to the observed ones."""
    angles = np.array([item.normal is None for item in _relations(model)], bool)
    turns = np.where(angles, np.round((observed[0, :, 0] - course[0, :, 0]) / (2 * np.pi)), 0.0)
    return course + 2 * np.pi * np.stack([turns, np.zeros_like(turns)], -1)


@eqx.filter_jit
def _energies(model: HasLagrangian, x: Array, v: Array) -> tuple[Array, Array]:
    def one(x: Array, v: Array) -> tuple[Array, Array]:
        state = State(Motion(x, v), {})
        return model.kinetic_energy(state), model.potential_energy(state)

    return jax.vmap(one)(x, v)


def _smooth(x: Float[np.ndarray, "T d"], dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities of local parabolas through seven frames (Savitzky and Golay 1964)."""
    half, (length, _) = min(_SMOOTHED, len(x)) // 2, x.shape
    position, velocity = np.empty_like(x), np.empty_like(x)
    for t in range(length):
        first = int(np.clip(t - half, 0, max(0, length - 2 * half - 1)))
        window = x[first : first + 2 * half + 1]
        powers = (first + np.arange(len(window)) - t)[:, None] ** np.arange(3)
        fitted = np.linalg.lstsq(powers, window, rcond=None)[0]
        position[t], velocity[t] = fitted[0], fitted[1] / dt
    return position, velocity
