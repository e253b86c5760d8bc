"""The physical constants of a trained model, measured on observed keypoint tracks, with error bars."""

from collections.abc import Container, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.evaluation.outcome import Evaluation
from keycld.evaluation.physics_file import Constant, MeasuredOn, Physics, Rejected, constant, unknown_constant
from keycld.mechanics import (
    ConstrainedLagrangian,
    Derived,
    Estimate,
    MechanicalDynamics,
    Motion,
    Scale,
    derive,
    estimate,
    physical_constants,
    predict_fan,
    rest_pose,
    terms_of,
)
from keycld.models.keycld.identify import evidence, explain
from keycld.models.keycld.law_fit import climb, free_leaves
from keycld.models.keycld.selection import Tried
from keycld.models.keycld.tracks import MISSED, Tracks

# So many observed poses are compared to find where the mechanism rests.
_POSES = 200
# Pixels of noise above which a keypoint may not be fixed to its part.
_RESTLESS = 0.5
# Half widths of the intervals that a prediction is compared with, in standard errors, by their shares in percent.
_INTERVALS = {"68": 1.0, "95": 1.96}
_SIGNED = ("pivot", "line_direction", "gravity_direction", "viscous_rate", "damping_ratio")
_UNITS = {
    "pivot": "units",
    "length": "units",
    "mass_ratio": "1",
    "period": "s",
    "viscous_rate": "1/s",
    "damping_ratio": "1",
    "coulomb_deceleration": "units/s²",
    "line_direction": "degrees",
    "gravity_direction": "degrees",
    "gravity_m": "m/s²",
    "gravity": "units/s²",
}
_NO_REST = "the mechanism has no stable rest pose"
_NOTES = {
    "mass_ratio": (
        "of point masses that would move alike, if all hang on a pivot; otherwise of the masses that resist at the "
        "keypoints, which depend on where on its link a keypoint is"
    ),
    "gravity_direction": "of the pull, counter-clockwise from the x axis: -90 is straight down",
    "gravity": "if the mass of the last part is on the line between its keypoints; for a single part, at its keypoint",
}
_ABSOLUTE = "one video shows ratios of masses and forces alone: M, V, friction and input share an unknown factor"


class Measured(NamedTuple):
    """The result of `measure_physics`.

    Attributes:
        physics: what `save_physics` stores.
        estimate: parameters and covariance, for `predict_fan`.
    """

    physics: Physics
    estimate: Estimate


def measure_physics(
    dynamics: MechanicalDynamics,
    x: Float[Array | np.ndarray, "N T dim"],
    u: Float[Array | np.ndarray, "N *T l"],
    dt: float,
    *,
    mechanism: str | None = None,
    scale: Scale | None = None,
    tried: Tried | None = None,
    pixel: float = 0.0,
) -> Measured:
    """Measure the physical constants of a mechanism from tracks of its keypoints.

    The law of a trained model is fitted once more, with exact derivatives, and the covariance of its parameters is
    carried to each constant (`estimate`, `derive`). Where no motions of the law follow a few recordings, pieces of them
    are fitted.

    Args:
        dynamics: those of a trained model, `model.dynamics`; they are near the solution.
        x: observed keypoints of the recordings that the constants are measured on, image-plane units.
        u: inputs, `[N, 0]` without any.
        dt: seconds between frames, in the time of the camera.
        mechanism: its name.
        scale: a known length or g, for constants in metres.
        tried: which forces the law was chosen from, for the evidence against the others (`evidence`); None: its
            forces were given.
        pixel: size of a pixel, image-plane units; for that evidence.

    Raises:
        KeycldError: the scale does not fit the mechanism, or the motion does not determine its parameters at all.
    """
    law = dynamics.law
    assert isinstance(law, ConstrainedLagrangian)
    seen = jnp.asarray(x, jnp.float32)
    shared = jnp.mean(jax.vmap(law.constraint)(seen.reshape(-1, seen.shape[-1])), axis=0)
    among = () if tried is None else tried.named
    recordings = Tracks(seen, jnp.asarray(u, jnp.float32), jnp.float32(dt), shared, among=among)
    _, followed = explain(dynamics, recordings)
    worth = {} if tried is None else evidence(dynamics, followed, pixel=pixel, tried=tried)
    found = _estimated(dynamics, followed)
    acting = terms_of(law)
    pieces, frames = found.paths.shape[:2]
    physics = Physics(
        mechanism=mechanism,
        fps=1 / float(dt),
        constants=constants_of(found, scale),
        rejected={
            kind: Rejected(worth=share, needed=tried.needed(kind))
            for kind, share in worth.items()
            if tried is not None and kind not in acting
        },
        prediction={},
        measured_on=MeasuredOn(pieces=pieces, frames=frames, whole=pieces == len(seen)),
        forces=sorted(acting),
    )
    return Measured(physics, found)


def _estimated(dynamics: MechanicalDynamics, tracks: Tracks) -> Estimate:
    """Return the estimate from recordings or, where its motions diverge or miss them, from halves, quarters, ….

    It integrates more finely than the fits of a training, and a chaotic motion may leave the recording for that.
    """
    halves = tracks.halved()
    try:
        near = climb(dynamics, tracks)
        free, dt = free_leaves(near.dynamics), float(tracks.dt)
        found = estimate(near.dynamics, free, tracks.x, tracks.u, dt, initial=near.initial)
        if found.misfit <= MISSED or halves is None:
            return found
    except KeycldError:
        if halves is None:
            raise
    return _estimated(dynamics, halves)


def with_fan(motion: Evaluation, found: Estimate, u: Float[np.ndarray, "*T l"]) -> Evaluation:
    """Add the noise of the keypoints, and the prediction with error bars, to a motion that the estimate has not seen.

    It starts from the same given frames (`predict_fan`). The interval of an observed coordinate also has the noise of
    the observation.

    Args:
        motion: of `evaluate_motion`.
        found: the measured parameters.
        u: input of the first recording of the split, constant `[l]` or held per frame.

    Returns:
        The motion with the arrays `fan_off` `[T, K, 2]`, observed minus predicted, and `fan_sigma`, and the score
        `within`: shares of the predicted coordinates that were observed in their 68 and 95 % intervals; without these
        if the prediction diverges. The score `noise` is how far each observed keypoint is from the fitted motions,
        pixels.
    """
    given, dt = motion.scores["given"], motion.scores["dt"]
    pixels = (found.noise / motion.scores["pixel"]).round(3).tolist()
    scores = motion.scores | {"noise": dict(zip(motion.scores["keypoints"], pixels, strict=True))}
    observed, near = motion.arrays["observed"], motion.arrays["predicted"].reshape(len(motion.arrays["predicted"]), -1)
    start = Motion(near[0], (4 * near[1] - near[2] - 3 * near[0]) / (2 * dt))
    try:
        fan = predict_fan(found, observed[:given].reshape(given, -1), u, len(observed), initial=start)
    except KeycldError:
        return Evaluation(scores, motion.arrays)
    sigma = np.sqrt(fan.sigma**2 + fan.noise[:, None] ** 2)
    off = observed - fan.keypoints
    far = np.abs(off / sigma)[given:]
    within = {share: float(np.mean(far < most)) for share, most in _INTERVALS.items()}
    return Evaluation(scores | {"within": within}, motion.arrays | {"fan_off": off, "fan_sigma": sigma})


def restless(noise: Mapping[str, float]) -> str:
    """Return what may be wrong with keypoints that are far from the fitted motions: `noise`, pixels. "" if none is.

    Measured: 0.06 to 0.13 pixels on drawn pendulums, 0.25 on a real one, 0.84 where a keypoint slid within its part.
    """
    far = {name: pixels for name, pixels in noise.items() if pixels > _RESTLESS}
    if not far:
        return ""
    which = ", ".join(f"'{name}' {pixels:.2f}" for name, pixels in far.items())
    return (
        f"keypoints are far from the fitted motion ({which} pixels): they may slide on their parts, or a force is "
        "missing. Look at the movie before you use the constants."
    )


def constants_of(found: Estimate, scale: Scale | None = None) -> dict[str, Constant]:
    """Return the physical constants of an estimate with their error bars.

    None has a value where the fitted motions are far from the tracks: the fit ended elsewhere, or the law is wrong.
    """
    poses = found.paths.reshape(-1, found.paths.shape[-1])[:: max(1, found.paths[..., 0].size // _POSES)]
    with jax.enable_x64(True):
        law, values = found.unknowns.law(jnp.asarray(found.eta))
        pose = rest_pose(law, values, poses)
    derived = derive(found, physical_constants, pose, scale)
    constants = {name: _constant(name, number, derived) for name, number in derived.items()}
    if not any(getattr(term, "viscous", False) for term in terms_of(law).values()):
        constants["viscous_rate"] = Constant(
            value=0.0, sigma=None, unit="1/s", identifiable=True, note="no viscous friction acts; see rejected"
        )
    elif pose is None:
        constants["viscous_rate"] = unknown_constant("1/s", _NO_REST)
    if pose is None:
        constants["period_1"] = unknown_constant("s", _NO_REST)
    if found.misfit > MISSED:
        note = f"the fitted motions miss {found.misfit:.0%} of the motion, so they are not those of the mechanism"
        constants = {name: unknown_constant(each["unit"], note) for name, each in constants.items()}
    constants["mass"] = unknown_constant("kg", _ABSOLUTE)
    return constants


def _constant(name: str, number: Derived, among: Container[str]) -> Constant:
    unit = _unit(name, among)
    if not number.determined:
        return unknown_constant(unit, "the recordings do not determine it: other parameters can change with it")
    found = constant(number.value, number.sigma, unit, positive=not name.startswith(_SIGNED))
    note = next((note for prefix, note in _NOTES.items() if name.startswith(prefix)), None)
    if note is not None and found["identifiable"]:
        found["note"] = note
    return found


def _unit(name: str, among: Container[str]) -> str:
    """Return the unit of one of these constants: metres of `length_a_b_m`, unless `m` is itself the keypoint."""
    in_metres = name.startswith("length_") and name.endswith("_m") and name.removesuffix("_m") in among
    if name == "metres_per_unit" or in_metres:
        return "m"
    return next(unit for prefix, unit in _UNITS.items() if name.startswith(prefix))
