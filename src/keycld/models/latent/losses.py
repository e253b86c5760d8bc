"""What training a latent model minimises: the negative evidence lower bound, or the same as a constrained problem.

Likelihood: every value of a picture is normal with variance 1/2 around the rendered one, so −log p = (x − μ)² + ½ ln π.
Divergence: KL(q(z|x) ‖ N(0, 1)) = Σ ½ (μ² + σ² − 1 − ln σ²). S is the number of values, T H W 3, of a window's targets.
Consistency, which is ours: a state that a motion has reached is the one that the encoder sees there (`strayed`).
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PRNGKeyArray

from keycld._shares import over_clips
from keycld.data import Clip
from keycld.mechanics import Scalar, State
from keycld.models.base import Gaussian
from keycld.models.latent.model import AbstractLatentModel
from keycld.stages import AbstractLoss, AbstractStatefulLoss, Terms
from keycld.vision import ImageDecoder, mean_in_chunks

HALF_LOG_PI = 0.5 * math.log(math.pi)


class Targets(NamedTuple):
    """Which frames of a window are compared with rendered ones, and how.

    Attributes:
        both_ways: False: the encoder sees the first frames of each window. True: for the second half of the batch it
            sees the last ones, in the order of time, and motions run backward from there.
        given: whether frames before the state's are targets too.
        rendered: how many random targets of each window are rendered; 0 for all.
        at_once: frames that are rendered in parallel.
        cross_entropy: weight w of the pixels' cross-entropy beside their squared error. For a value x rendered as
            σ(l), the gradient by l is 2 (σ(l) − x) σ′(l) of the squared error, which vanishes where a wrong value is
            0 or 1, and w (σ(l) − x) of this one. Only the gradient counts: losses and errors leave its value out. None:
            no such gradient.
    """

    both_ways: bool
    given: bool
    rendered: int
    at_once: int
    cross_entropy: float | None = None


class Reconstruction(NamedTuple):
    """How well windows are rendered from their latent vectors.

    Attributes:
        squared_error: mean of (x − μ)² over all values of all target frames.
        strayed: how far motions are from the states that the encoder sees, by `strayed`; None where nobody asked.
        kl: divergence of the posterior from the prior, nats, mean over windows.
        frames: T, target frames of a window.
        values: S, values of a window's target frames.
        statistics: of posterior and decoder, for the log.
    """

    squared_error: Float[Array, ""]
    strayed: Float[Array, ""] | None
    kl: Float[Array, ""]
    frames: int
    values: int
    statistics: Terms


class ELBOLoss(AbstractLoss):
    """−log p(x|z) / S + β KL / S + γ strayed, mean over windows (eq. (3), and metrics of the released code).

    Attributes:
        beta: β. The benchmark tries 0.001, 0.1, 1 and 2.
        per_frame: β KL T / S instead: the likelihood counts as a mean over frames, as eq. (3) prints it.
        targets: which frames are compared.
        consistency: γ; None: motions are not compared with the encoder.
    """

    beta: float
    per_frame: bool
    targets: Targets
    consistency: float | None = None

    def __call__(
        self, model: AbstractLatentModel, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluate the loss on windows of consecutive frames."""
        found = reconstruct(model, clips, key, self.targets, self.consistency is not None)
        weight = self.beta * (found.frames if self.per_frame else 1) / found.values
        return _likelihood(found) + weight * found.kl + _inconsistency(found, self.consistency), _terms(found)


class GECOLoss(AbstractStatefulLoss):
    """λ C + KL / S + γ strayed, C = mean squared error − κ; Adam raises λ while C > 0, and lowers it below.

    λ = softplus(v) with λ = 1 at first. Rezende and Viola 2018, "Taming VAEs"; as in HGN, without
    its moving average.

    Attributes:
        kappa: κ, the error that is asked for.
        rate: learning rate of v.
        targets: which frames are compared.
        consistency: γ; None: motions are not compared with the encoder.
    """

    kappa: float
    rate: float
    targets: Targets
    consistency: float | None = None

    def initial(self) -> Any:
        """Return v = ln(e − 1) and the state of its Adam."""
        raw = jnp.log(jnp.expm1(jnp.ones(())))
        return {"raw": raw, "adam": optax.adam(self.rate).init(raw)}

    def __call__(
        self, model: AbstractLatentModel, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""], memory: Any
    ) -> tuple[Float[Array, ""], Terms, Any]:
        """Evaluate the loss on windows of consecutive frames, and move λ."""
        found = reconstruct(model, clips, key, self.targets, self.consistency is not None)
        raw, constraint = memory["raw"], found.squared_error - self.kappa
        multiplier = jax.nn.softplus(raw)
        # Ascent: Adam descends along the negative gradient of λ C.
        slope = -jax.lax.stop_gradient(constraint) * jax.nn.sigmoid(raw)
        update, adam = optax.adam(self.rate).update(slope, memory["adam"])
        loss = multiplier * constraint + found.kl / found.values + _inconsistency(found, self.consistency)
        terms = _terms(found) | {"constraint": constraint, "multiplier": multiplier}
        return loss, terms, {"raw": raw + update, "adam": adam}


def reconstruct(
    model: AbstractLatentModel, clips: Clip, key: PRNGKeyArray, targets: Targets, consistent: bool = False
) -> Reconstruction:
    """Sample a latent vector for each window and render the window from it.

    Args:
        model: any model of the family.
        clips: windows of consecutive frames, at least as long as what the model is given.
        key: of the samples.
        targets: which frames are compared.
        consistent: whether motions are compared with the encoder too.
    """
    assert clips.frames is not None
    batch, length, height, width, _ = clips.frames.shape
    halves = [(slice(0, batch // 2), 0), (slice(batch // 2, batch), length - model.given)]
    posteriors, states = [], []
    for part, first in halves if targets.both_ways else [(slice(0, batch), 0)]:
        posterior = jax.vmap(model.posterior)(clips.frames[part, first : first + model.given])
        noise = jax.random.normal(jax.random.fold_in(key, first), posterior.mean.shape)
        latent = posterior.mean + posterior.deviation * noise

        def motion(
            model: AbstractLatentModel, latent: Array, u: Array, dt: Array, at: int = first + model.anchored
        ) -> State:
            return model.unroll(model.state(latent), at, dt, u, length)

        states.append(over_clips(motion, model, latent, clips.u[part], clips.dt[part]))
        posteriors.append(posterior)
    earliest = 0 if targets.given else model.anchored
    moved = jax.tree.map(lambda *parts: jnp.concatenate(parts), *states)
    visible, frames = jax.vmap(jax.vmap(model.visible))(moved)[:, earliest:], clips.frames[:, earliest:]
    count = length - earliest
    if 0 < targets.rendered < count:
        # A key of its own: halves use the number of a frame of the window.
        keys = jax.random.split(jax.random.fold_in(key, length), batch)
        chosen = jax.vmap(lambda k: jax.random.choice(k, count, (targets.rendered,), replace=False))(keys)
        visible, frames = (jax.vmap(lambda window, k: window[k])(each, chosen) for each in (visible, frames))

    def squared_error(decoder: ImageDecoder, pair: tuple[Array, Array]) -> Array:
        shown, frame = pair
        logits = decoder.logits(shown)
        error = jnp.mean((jax.nn.sigmoid(logits) - frame) ** 2)
        if targets.cross_entropy is None:
            return error
        beside = targets.cross_entropy * jnp.mean(optax.sigmoid_binary_cross_entropy(logits, frame))
        return error + (beside - jax.lax.stop_gradient(beside))

    flat = (visible.reshape(-1, visible.shape[-1]), frames.reshape(-1, height, width, 3))
    posterior = Gaussian(*(jnp.concatenate(part) for part in zip(*posteriors, strict=True)))
    error = mean_in_chunks(squared_error, model.decoder, flat, targets.at_once)
    return Reconstruction(
        squared_error=error,
        strayed=strayed(model, clips.frames, moved, jax.random.fold_in(key, length + 1)) if consistent else None,
        kl=jnp.mean(jax.vmap(divergence)(posterior)),
        frames=count,
        values=count * height * width * 3,
        statistics=posterior_statistics(posterior) | {"explained": 1.0 - error / jnp.mean(jnp.var(flat[1], axis=0))},
    )


def strayed(
    model: AbstractLatentModel, frames: Float[Array, "B T H W 3"], states: State, key: PRNGKeyArray
) -> Float[Array, ""]:
    """Return how far motions are from the states that the encoder sees: |z − μ|² in units of the variance of μ.

    z is the state that a motion has reached at a random place of its window, μ that of the posterior's mean, given the
    frames there. The targets do not ask for it: a motion may reproduce them with numbers that no frame shows, and leave
    all that it has seen when the targets end. Means over windows; a smaller latent space is not a smaller distance.

    A hundredth of the posterior's variance is added to that of μ, which is next to nothing at first. Without it a
    posterior without noise was the shortest way to a small quotient: on three (HGN) to six (ODE[TR]) of thirteen sets
    its deviation underflowed within fifty steps, and KL was infinite. With all of it, HGN saw nothing of mass spring
    for 600 steps.

    Args:
        model: any model of the family.
        frames: of the windows.
        states: of all their frames, rolled out.
        key: of the places.
    """
    batch, length = frames.shape[:2]

    def compared(frames: Array, states: State, first: Array) -> tuple[Array, Array, Array]:
        mean, deviation = model.posterior(jax.lax.dynamic_slice_in_dim(frames, first, model.given))
        reached = jax.tree.map(lambda each: each[first + model.anchored], states.coordinates)
        seen, beside = model.state(mean).coordinates, model.state(mean + deviation).coordinates
        return ravel_pytree(reached)[0], ravel_pytree(seen)[0], ravel_pytree(beside)[0]

    first = jax.random.randint(key, (batch,), 0, length - model.given + 1)
    reached, seen, beside = jax.vmap(compared)(frames, states, first)
    distance, noise = (jnp.mean(jnp.sum((each - seen) ** 2, axis=1)) for each in (reached, beside))
    return distance / (jnp.sum(jnp.var(seen, axis=0)) + 0.01 * noise)


def divergence(posterior: Gaussian) -> Float[Array, ""]:
    """Return KL(N(μ, σ²) ‖ N(0, 1)), summed over the latent vector."""
    mean, deviation = posterior
    return jnp.sum(0.5 * (mean**2 + deviation**2 - 1.0) - jnp.log(deviation))


def posterior_statistics(posterior: Gaussian) -> Terms:
    """Return what a batch of posteriors says about the use of the latent vector.

    A number of z that says nothing of the frames has the prior's mean 0 and deviation 1.

    - `posterior_deviation`: σ, mean over batch and latent vector.
    - `posterior_spread`: deviation of μ over the batch, mean over the latent vector.
    - `informative`: how many numbers of z have a mean variance below 1/2.
    """
    mean, deviation = posterior
    return {
        "posterior_deviation": jnp.mean(deviation),
        "posterior_spread": jnp.mean(jnp.std(mean, axis=0)),
        "informative": jnp.sum(jnp.mean(deviation**2, axis=0) < 0.5).astype(jnp.float32),
    }


def _likelihood(found: Reconstruction) -> Array:
    """Return −log p(x|z) / S."""
    return found.squared_error + HALF_LOG_PI


def _inconsistency(found: Reconstruction, weight: Scalar | None) -> Scalar:
    return 0.0 if found.strayed is None or weight is None else weight * found.strayed


def _terms(found: Reconstruction) -> Terms:
    terms = {"log_likelihood": -_likelihood(found), "squared_error": found.squared_error, "kl": found.kl}
    if found.strayed is not None:
        terms["strayed"] = found.strayed
    return terms | jax.lax.stop_gradient(found.statistics)
