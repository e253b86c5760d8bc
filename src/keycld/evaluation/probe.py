"""How well a model's keypoints know the true state, through the best affine map to the system's landmarks.

Keypoints are free to lie anywhere on a moving part, so their distance to a landmark means nothing by itself. The map is
fitted on validation frames with the keypoints that the encoder observes, then used unchanged on the scored split.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from keycld._errors import KeycldError
from keycld.evaluation.geometry import difference, nearest, positions

if TYPE_CHECKING:
    from keycld.systems import AbstractSystem


@dataclass(frozen=True)
class Probe:
    """An affine map from keypoints to landmarks, and the way from landmarks to the system's coordinates.

    Attributes:
        system: whose `landmarks(state)` tell where they truly are.
        matrix: `[2K + 1, 2L]`, the last row the offset.
        guesses: states `[G, d]` from which the inversion of the landmarks starts.
        angles: which positions are angles.
    """

    system: "AbstractSystem"
    matrix: Float[np.ndarray, "inputs outputs"]
    guesses: Float[np.ndarray, "G d"]
    angles: Bool[np.ndarray, "m"]

    def landmarks(self, keypoints: Float[np.ndarray, "*any K 2"]) -> Float[np.ndarray, "*any L 2"]:
        """Return the landmarks that the keypoints stand for, in image-plane units."""
        return (with_one(keypoints) @ self.matrix).reshape(*keypoints.shape[:-2], -1, 2)

    def landmark_errors(
        self, keypoints: Float[np.ndarray, "*any K 2"], state: Float[np.ndarray, "*any d"]
    ) -> Float[np.ndarray, "*any"]:
        """Compute the distance from probed to true landmarks: root mean square over them, in image-plane units."""
        gap = self.landmarks(keypoints) - self.system.landmarks(state)
        return np.sqrt(np.mean(np.sum(gap**2, axis=-1), axis=-1))

    def coordinate_errors(
        self, keypoints: Float[np.ndarray, "*any K 2"], state: Float[np.ndarray, "*any d"]
    ) -> Float[np.ndarray, "*any m"]:
        """Compute |probed − true| of each position: angles in degrees within ±180, others in their own unit."""
        q = invert_landmarks(self.system, self.landmarks(keypoints), self.guesses)
        gap = np.abs(difference(q, positions(state), self.angles))
        return np.where(self.angles, np.degrees(gap), gap)


def with_one(keypoints: np.ndarray) -> np.ndarray:
    """Return points `[*any, K, 2]` as rows `[*any, 2K + 1]` that end with a one."""
    flat = keypoints.reshape(*keypoints.shape[:-2], -1).astype(np.float64)
    return np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1)


def fit_probe(
    system: "AbstractSystem",
    keypoints: Float[np.ndarray, "M K 2"],
    state: Float[np.ndarray, "M d"],
    guesses: Float[np.ndarray, "G d"],
    angles: Bool[np.ndarray, "m"],
) -> Probe:
    """Fit the least-squares map from `keypoints` and a one to the system's landmarks of `state`.

    Raises:
        KeycldError: a keypoint is not finite.
    """
    if not np.all(np.isfinite(keypoints)):
        raise KeycldError(
            "the model observes keypoints that are not finite, so its weights are damaged: train it again."
        )
    targets = system.landmarks(state).reshape(len(state), -1)
    matrix, *_ = np.linalg.lstsq(with_one(keypoints), targets, rcond=None)
    return Probe(system, matrix, guesses, angles)


def invert_landmarks(
    system: "AbstractSystem",
    landmarks: Float[np.ndarray, "*any L 2"],
    guesses: Float[np.ndarray, "G d"],
    iterations: int = 8,
) -> Float[np.ndarray, "*any m"]:
    """Find positions q whose landmarks are nearest to the given ones, by damped Gauss–Newton from the nearest guess.

    Landmarks that are not finite give positions that are not.
    """
    flat = landmarks.reshape(-1, landmarks.shape[-2] * 2)
    targets = np.nan_to_num(flat, posinf=0.0, neginf=0.0)
    guess = guesses[nearest(targets, system.landmarks(guesses).reshape(len(guesses), -1))]
    m = guesses.shape[-1] // 2
    q, rest = guess[:, :m].copy(), np.zeros_like(guess[:, m:])

    def landmarks_at(q: np.ndarray) -> np.ndarray:
        return system.landmarks(np.concatenate([q, rest], axis=-1)).reshape(len(q), -1)

    step = 1e-5
    for _ in range(iterations):
        columns = [(landmarks_at(q + step * unit) - landmarks_at(q - step * unit)) / (2.0 * step) for unit in np.eye(m)]
        jacobian = np.stack(columns, axis=-1)
        normal = np.einsum("nai,naj->nij", jacobian, jacobian) + 1e-9 * np.eye(m)
        slope = np.einsum("nai,na->ni", jacobian, targets - landmarks_at(q))
        # Half a radian at most, so that a target out of reach does not make it diverge.
        q += np.clip(np.linalg.solve(normal, slope[..., None])[..., 0], -0.5, 0.5)
    q[~np.all(np.isfinite(flat), axis=1)] = np.nan
    return q.reshape(*landmarks.shape[:-2], m)


def probe_scores(
    probe: Probe,
    fit: tuple[np.ndarray, np.ndarray],
    observed: tuple[np.ndarray, np.ndarray],
    rolled: tuple[np.ndarray, np.ndarray],
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Compute scores and curves of a probe.

    Args:
        probe: fitted.
        fit: keypoints observed by the encoder and true states on the frames of the fit, `[M, K, 2]` and `[M, d]`.
        observed: the same on frames of the scored split.
        rolled: predicted keypoints `[N, T, K, 2]` and true states `[N, T, d]`.

    Returns:
        scores: `residual_fit` and `residual` of the encoder, `rollout` and `rollout_last` of the prediction
            (root mean square distance, image-plane units; a pixel of 64 is 0.032), and for each position
            its mean error over the roll-out and at the last frame.
        arrays: `landmark_error [N, T]`, `coordinate_error [N, T, m]`.
    """
    landmark, coordinate = probe.landmark_errors(*rolled), probe.coordinate_errors(*rolled)
    names, units = probe.system.state_names, probe.system.units
    coordinates = [
        {
            "name": names[k],
            "unit": "deg" if angle else units[k],
            "mean": float(np.mean(coordinate[..., k])),
            "last_mean": float(np.mean(coordinate[:, -1, k])),
            "last_median": float(np.median(coordinate[:, -1, k])),
        }
        for k, angle in enumerate(probe.angles)
    ]
    scores = {
        "landmarks": list(probe.system.keypoints),
        "residual_fit": _root_mean_square(probe.landmark_errors(*fit)),
        "residual": _root_mean_square(probe.landmark_errors(*observed)),
        "rollout": _root_mean_square(landmark),
        "rollout_last": _root_mean_square(landmark[:, -1]),
        "coordinates": coordinates,
    }
    return scores, {"landmark_error": landmark, "coordinate_error": coordinate}


def _root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
