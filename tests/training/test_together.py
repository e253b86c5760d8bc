"""Several trainings that take their steps in one program."""

import threading
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld.data import RandomFrames, Resident
from keycld.stages import AbstractLoss, Group, Stage
from keycld.training import Together
from keycld.training.step import initial_progress, make_step


class Line(eqx.Module):
    slope: jax.Array


class Shade(AbstractLoss):
    """Squared distance of a number from the pictures' shade."""

    traced = 0

    def __call__(self, model, clips, *, key, step):
        type(self).traced += 1
        loss = jnp.mean((model.slope - clips.frames) ** 2) + 1e-3 * jax.random.normal(key)
        return loss, {"slope": model.slope}


STAGE = Stage("s", 10, RandomFrames(3), Shade(), (Group("all", lambda m: m, 0.1),))


def shades(level, trajectories=4):
    image = np.full((trajectories, 5, 4, 4, 3), level, np.uint8)
    return Resident(jnp.asarray(image), jnp.zeros((trajectories, 0)), jnp.array(0.1))


def take(run, data, dispatches=2):
    progress, rest = initial_progress(STAGE, Line(jnp.array(0.0)))
    for _ in range(dispatches):
        progress, terms = run((rest, data), progress)
    return float(progress.parameters.slope), np.asarray(terms["loss"])


def test_each_training_has_the_outcome_that_it_has_alone():
    """Other data, other numbers of trajectories, other seeds, in one program."""
    data = [shades(50), shades(200, 7), shades(120)]
    alone = [take(make_step(STAGE, 0, seed, 5), each) for seed, each in enumerate(data)]
    Shade.traced = 0
    group = Together(3)
    with ThreadPoolExecutor(3) as threads:
        found = list(
            threads.map(
                lambda member, each: take(make_step(STAGE, 0, member.number, 5, take=member.take), each),
                group.members,
                data,
            )
        )
    for (slope, losses), (expected, expected_losses) in zip(found, alone, strict=True):
        assert slope == pytest.approx(expected, abs=1e-6)
        np.testing.assert_allclose(losses, expected_losses, atol=1e-6)
    assert len({slope for slope, _ in alone}) == 3
    assert Shade.traced == 1


def test_a_training_that_ends_or_fails_lets_the_others_go_on():
    group = Together(3)
    first, second, third = group.members
    found = {}

    def train_on(member, dispatches):
        found[member.number] = take(make_step(STAGE, 0, 0, 5, take=member.take), shades(90), dispatches)
        member.leave()
        member.leave()

    threads = [threading.Thread(target=train_on, args=pair) for pair in ((first, 1), (second, 2))]
    for thread in threads:
        thread.start()
    third.leave()  # its data could not be made
    for thread in threads:
        thread.join(60)
    for dispatches, (slope, _) in zip((1, 2), (found[0], found[1]), strict=True):
        assert slope == pytest.approx(take(make_step(STAGE, 0, 0, 5), shades(90), dispatches)[0], abs=1e-6)


def test_an_error_of_the_program_reaches_every_training():
    class Broken(Shade):
        def __call__(self, model, clips, *, key, step):
            raise KeycldError("the lamp is out")

    stage = Stage("s", 10, RandomFrames(3), Broken(), STAGE.groups)
    group = Together(2)

    def attempt(member):
        progress, rest = initial_progress(stage, Line(jnp.array(0.0)))
        with pytest.raises(KeycldError, match="the lamp is out"):
            make_step(stage, 0, 0, 5, take=member.take)((rest, shades(1)), progress)
        return True

    with ThreadPoolExecutor(2) as threads:
        assert list(threads.map(attempt, group.members)) == [True, True]
