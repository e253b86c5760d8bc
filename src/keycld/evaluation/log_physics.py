"""Identification of a rig from a log of joint positions and torques."""

import math
import re
from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from keycld._errors import KeycldError
from keycld.data.imports.log import Log
from keycld.evaluation.physics_file import Constant, Physics, constant
from keycld.mechanics import Constraints, FittedJointLaw, Joint, JointLaw, fit_joint_law, joints_of, predict_joints

# Units of the constants of joints, by how many of their joints are slides; an inertia belongs to two.
_UNITS = {
    "inertia": ("kg m²", "kg m", "kg"),
    "gravity_torque": ("N m", "N"),
    "stiffness": ("N m", "N/m"),
    "viscous_friction": ("N m s", "N s/m"),
    "dry_friction": ("N m", "N"),
    "torque_offset": ("N m", "N"),
}


class IdentifiedLog(NamedTuple):
    """The result of `identify_log`.

    Attributes:
        physics: what `save_physics` stores.
        time: seconds of the held-out samples `[T]`.
        measured: joint positions there `[T, d]`.
        predicted: those of the law, from the first samples and the torques; empty if nothing is held out, or if they
            diverge.
        sigma: standard errors of the predicted positions.
    """

    physics: Physics
    time: Float[np.ndarray, "T"]
    measured: Float[np.ndarray, "T d"]
    predicted: Float[np.ndarray, "T d"]
    sigma: Float[np.ndarray, "T d"]


def identify_log(
    log: Log,
    constraints: Constraints,
    mechanism: str | None,
    *,
    lengths: tuple[float, ...] | None = None,
    held: float = 1 / 3,
    given: float = 0.1,
) -> IdentifiedLog:
    """Find inertia, weight and friction of a rig from the first part of a log, and predict the rest from its torques.

    A measured torque determines the common factor of masses and forces that a video leaves open.

    Args:
        log: positions and torques, one torque for each of the first joints.
        constraints: of the mechanism, an open chain.
        mechanism: its name.
        lengths: of the links, metres; 1 each by default. Inertias and torques of joints do not depend on them.
        held: share of the log at its end that only the prediction is compared with.
        given: seconds of the held-out part from which the prediction begins.

    Raises:
        KeycldError: the columns do not fit the mechanism, or the log does not determine the law.
    """
    joints = joints_of(constraints)
    if log.q.shape[1] != len(joints):
        raise KeycldError(f"this mechanism has {len(joints)} joints, but {log.q.shape[1]} positions are named.")
    if not 0 < log.u.shape[1] <= len(joints):
        raise KeycldError(f"name 1 to {len(joints)} columns of torques with --input, not {log.u.shape[1]}.")
    if not 0 <= held < 0.9:
        raise KeycldError(f"the held-out share is from 0 to 0.9, not {held}.")
    long = lengths or (1.0,) * len(joints)
    if len(long) != len(joints) or not all(0 < length < math.inf for length in long):
        said = " ".join(f"{length:g}" for length in long)
        raise KeycldError(f"--lengths are {len(joints)} lengths above 0, one a joint, not {said}.")
    if not np.any(log.u):
        raise KeycldError("all torques of this log are zero: a free swing does not tell inertias, so drive the joints.")
    # An encoder that begins again after each turn jumps.
    q = np.where([joint.slide for joint in joints], log.q, np.unwrap(log.q, axis=0))
    torque = np.pad(log.u, ((0, 0), (0, len(joints) - log.u.shape[1])))
    fitted = round((1 - held) * len(q))
    found = fit_joint_law(joints, long, q[:fitted], torque[:fitted], log.dt)
    with jax.enable_x64(True):
        constants = dict(_constants(found, joints, long))
    count = max(4, round(given / log.dt))
    measured, prediction, note = q[fitted:], {}, ""
    predicted, sigma = np.zeros((2, 0, len(joints)))
    if len(measured) > count:
        try:
            predicted, sigma = predict_joints(found, joints, long, measured[:count], torque[fitted:], log.dt)
        except KeycldError as error:
            note = str(error)
    if len(predicted):
        off = (predicted - measured)[count:]
        prediction = {
            "given_seconds": count * log.dt,
            "seconds": len(off) * log.dt,
            "rms": np.sqrt(np.mean(off**2, axis=0)).tolist(),
            "sigma_rms": np.sqrt(np.mean(sigma[count:] ** 2, axis=0)).tolist(),
            "range": np.ptp(measured, axis=0).tolist(),
        }
    physics = Physics(mechanism=mechanism, fps=1 / log.dt, constants=constants, rejected={}, prediction=prediction)
    if note:
        physics["note"] = note
    return IdentifiedLog(physics, log.dt * np.arange(fitted, len(q)), measured, predicted, sigma)


def _constants(
    found: FittedJointLaw, joints: tuple[Joint, ...], lengths: tuple[float, ...]
) -> Iterator[tuple[str, Constant]]:
    """Return inertia at rest, gravity torque or stiffness, friction and offset of the joints; all are linear in θ."""
    d = len(joints)

    def of(theta: jax.Array) -> dict[str, jax.Array]:
        law = JointLaw.of(theta, joints, lengths)
        inertia = law.inertia(jnp.zeros(d, theta.dtype))
        named = {f"inertia_{i + 1}_{j + 1}": inertia[i, j] for i in range(d) for j in range(i, d)}
        parts = {
            "gravity_torque": law.gravity_torques(),
            "stiffness": law.stiffness,
            "viscous_friction": law.viscous,
            "dry_friction": law.dry,
            "torque_offset": law.offset,
        }
        return named | {f"{name}_{k + 1}": part[k] for name, part in parts.items() for k in range(d)}

    theta = jnp.asarray(found.theta)
    slopes, values = jax.jacfwd(of)(theta), of(theta)
    own = {f"inertia_{i + 1}_{i + 1}" for i in range(d)}
    for name, slope in slopes.items():
        g = np.asarray(slope)
        unit = _UNITS[name.rstrip("_0123456789")][sum(joints[int(k) - 1].slide for k in re.findall(r"\d+", name))]
        short = name.replace("_1_1", "").removesuffix("_1") if d == 1 else name
        sigma = float(np.sqrt(g @ found.covariance @ g))
        if sigma > 0 or float(values[name]) != 0:
            # All but the inertia of a single joint may be zero.
            yield short, constant(float(values[name]), sigma, unit, positive=name in own)
