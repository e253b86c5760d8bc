"""Frames a second through keypoint estimator and renderer, with gradients: our networks compared with the paper's.

Both alternate in one run, so that the speed of the machine cancels in the ratio. Prints JSON.
"""

import json
import statistics
import time

import equinox as eqx
import jax
import jax.numpy as jnp

from keycld.vision import KeypointEstimator, LightUNet, PaperUNet, Renderer, Standardise

BATCH, ROUNDS, KEYPOINTS = 16, 7, 2


def networks(unet, width, stride, key):
    """Return an estimator and a renderer for 64 × 64 pixels."""
    keys = jax.random.split(key)
    still = Standardise(jnp.full((64, 64, 3), 0.5), jnp.ones(())) if stride > 1 else None
    features = jnp.zeros((64 // stride, 64 // stride, width - KEYPOINTS))
    estimator = KeypointEstimator(unet(3 * stride**2, KEYPOINTS, width, key=keys[0]), still, stride)
    return estimator, Renderer(unet(width, 3 * stride**2, width, key=keys[1]), features, None, stride, 0.1)


@eqx.filter_jit
@eqx.filter_value_and_grad
def reconstruct(model, frames):
    """Return the reconstruction error of a batch."""
    estimator, renderer = model
    rendered = jax.vmap(lambda frame: renderer(estimator(frame).keypoints))(frames)
    return jnp.mean(jnp.sum((rendered - frames) ** 2, axis=(1, 2, 3)))


def main():
    """Time both alternately and print medians."""
    frames = jax.random.uniform(jax.random.key(0), (BATCH, 64, 64, 3))
    models = {
        "paper": networks(PaperUNet, 32, 1, jax.random.key(1)),
        "light": networks(LightUNet, 16, 2, jax.random.key(2)),
    }
    seconds = {name: [] for name in models}
    for round_ in range(ROUNDS + 1):
        for name, model in models.items():
            before = time.perf_counter()
            jax.block_until_ready(reconstruct(model, frames))
            if round_ > 0:  # the first round compiles
                seconds[name].append(time.perf_counter() - before)
    rate = {name: BATCH / statistics.median(values) for name, values in seconds.items()}
    result = {"bench": "vision", "frames_per_second": {k: round(v, 1) for k, v in rate.items()}}
    print(json.dumps(result | {"ratio": round(rate["light"] / rate["paper"], 2)}))


if __name__ == "__main__":
    main()
