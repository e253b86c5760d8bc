"""Preparations that measure what predictions know beforehand: the priors of initial velocity and own parameters.

A preparation is a function (model, resident data) → (model, resident data), called before the first step of a stage.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld.data import Resident
from keycld.mechanics import moved
from keycld.models.keycld.identify import refit
from keycld.models.keycld.law_fit import followed
from keycld.models.keycld.observe import FITTED, chosen, observed_keypoints
from keycld.models.keycld.own_initial_state import OwnPrior, own_guess
from keycld.models.keycld.tracks import Tracks
from keycld.models.keycld.velocity_prior import VelocityPrior

# Frames that are given, as the prior of own parameters sees them.
_SEEN = 5
_velocity_prior = eqx.filter_jit(VelocityPrior.measured)


def measure_velocity_prior(model: Any, data: Resident, *, trajectories: int = FITTED) -> tuple[Any, Resident]:
    """Measure the velocity prior (`VelocityPrior.measured`) on the observed keypoints of training recordings.

    A model without a prior is returned unchanged.

    Args:
        model: the model whose prior is measured.
        data: the training data.
        trajectories: about how many of the recordings are observed.
    """
    if model.velocity_prior is None:
        return model, data
    x, u = observed_keypoints(model, data, trajectories, taken_up=False)
    prior = _velocity_prior(model.dynamics, model.initial_state, x, u, data.dt)
    return eqx.tree_at(lambda m: m.velocity_prior, model, prior), data


def measure_own_prior(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Fit once more, and measure the prior of own parameters (`OwnPrior`) on recordings whose motion tells them.

    Recordings that no motion of the law follows are left out.
    """
    rows, begin, _ = chosen(data, FITTED)
    x, u = observed_keypoints(model, data, FITTED)
    fitted, _ = refit(model.dynamics, Tracks(x, u, data.dt, model.constants, own=own_guess(model, x)))
    own, x = np.asarray(fitted.own, float), np.asarray(x)
    near = followed(fitted)
    light = [_light(model, data.image[i][k : k + _SEEN]) for i, k in zip(rows, begin, strict=True)]
    constants = jax.vmap(lambda x, place: jnp.mean(jax.vmap(model.constraint)(moved(x, place)), axis=0))(
        jnp.asarray(x), jnp.asarray(own[:, :2], jnp.float32)
    )
    prior = OwnPrior.measured(own[near], x[near, :_SEEN], np.stack(light)[near], np.asarray(constants)[near])
    spread = np.sqrt(np.diagonal(prior.factor_root @ prior.factor_root.T))
    print(
        f"own          {near.sum()} recordings; log factors of masses and friction vary by "
        f"{np.array2string(own[near][:, 2:].std(axis=0), precision=3)}, known to "
        f"{np.array2string(spread, precision=3)} by what is seen",
        flush=True,
    )
    # Factors mean nothing without the law of the same fit: (μ, V) is known up to a common factor.
    return eqx.tree_at(lambda m: (m.dynamics, m.initial_state.prior), model, (fitted.dynamics, prior)), data


@eqx.filter_jit
def _light(model: Any, image: jax.Array) -> jax.Array:
    frames = image.astype(jnp.float32) / 255.0
    return model.part_light(frames, model.observe_clips(frames[None]).keypoints).reshape(-1)
