"""Laws that are known exactly, held to true motions."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from keycld.data import Trajectories
from keycld.evaluation import Probe
from keycld.evaluation.acceleration import acceleration_error
from keycld.evaluation.friction import friction_rates
from keycld.mechanics import (
    AbstractDynamics,
    ConstrainedLagrangian,
    MechanicalDynamics,
    PointMasses,
    Rattle,
    SumDissipation,
    SumPotential,
    ViscousFriction,
)
from keycld.models.base import HasLagrangian
from keycld.systems import Conditions, get

LENGTH, INERTIA, FRICTION, G = 0.8, 0.8**2 + 0.4 * 0.14**2, 0.1, 9.81
SYSTEM = get("zoo/damped_pendulum")


class Known(HasLagrangian):
    """A model that is only its law."""

    dynamics: AbstractDynamics

    @property
    def law(self):
        return self.dynamics.law

    @property
    def constants(self):
        return None


def pendulum(friction):
    """The bob as a point of mass 1, in image-plane units: V and R divided by J / l²."""
    scale = float(np.diff(SYSTEM.to_image_plane(np.array([[0.0, 0.0], [1.0, 0.0]]))[:, 0])[0])
    slowing = SumDissipation({"viscous": ViscousFriction(jnp.array([[friction / INERTIA]]))}) if friction else None
    potential = SumPotential(jnp.array([0.0, G * scale * LENGTH**2 / INERTIA]), {})
    law = ConstrainedLagrangian(PointMasses.ones(1), potential, None, SYSTEM.constraints, slowing)
    return Known(MechanicalDynamics(law, Rattle(4)))


def test_accelerations_are_compared_with_the_inputs_that_act(monkeypatch):
    """Those before the frame; q̈ of a pendulum is linear in sin q, q̇ and the torque."""
    system = get("pendulum")
    run = system.record(np.random.RandomState(3), 40, Conditions(input="random-walk"))
    recordings = Trajectories(
        run.time, run.input[None], state=run.state[None], state_derivative=run.state_derivative[None]
    )
    probe = Probe(system, np.zeros((3, 2)), np.zeros((1, 2)), np.array([True]))
    seen = []

    def accelerations(model, x, v, u):
        seen.append(u)
        return jnp.zeros_like(x)

    monkeypatch.setattr("keycld.evaluation.acceleration._accelerations", accelerations)
    data = SimpleNamespace(split=lambda *_, **__: recordings)
    acceleration_error(free_points(1), probe, (system.landmarks(run.state), run.state), data, "test")
    state, true = run.state[1:], run.state_derivative[1:, 1]
    causes = np.stack([np.sin(state[:, 0]), state[:, 1], np.asarray(seen[0])[:, 0]], axis=1)
    off = true - causes @ np.linalg.lstsq(causes, true, rcond=None)[0]
    assert np.ptp(causes[:, 2]) > 0.1 and np.max(np.abs(off)) < 1e-3 * np.max(np.abs(true))


@pytest.mark.parametrize("friction", [0.0, 0.5 * FRICTION, FRICTION])
def test_friction_of_a_hinge_has_the_rate_c_over_j(rng, friction):
    """Whatever the motion."""
    state = np.stack([rng.uniform(-np.pi, np.pi, 200), rng.uniform(-6, 6, 200)], axis=1)
    rates = friction_rates(pendulum(friction), SYSTEM, (SYSTEM.landmarks(state), state), state[:50])
    assert rates is not None
    np.testing.assert_allclose(rates["true"], FRICTION / INERTIA, rtol=1e-6)
    np.testing.assert_allclose(rates["found"], friction / INERTIA, rtol=1e-3, atol=1e-6)


def test_a_pendulum_without_friction_has_the_rate_zero(rng):
    """Not a rounding error of the difference of two energies."""
    system = get("pendulum")
    state = np.stack([rng.uniform(-np.pi, np.pi, 50), rng.uniform(-6, 6, 50)], axis=1)
    rates = friction_rates(free_points(1), system, (system.landmarks(state), state), state)
    assert rates == {"found": 0.0, "true": 0.0}


def free_points(count):
    """A law without any force."""
    law = ConstrainedLagrangian(PointMasses.ones(count), SumPotential(jnp.zeros(2 * count), {}))
    return Known(MechanicalDynamics(law, Rattle(1)))


@pytest.mark.parametrize("name", ["acrobot", "zoo/spring_cart", "zoo/four_bar", "zoo/two_bodies"])
def test_without_friction_the_rate_is_zero_in_every_state(rng, name):
    """Springs, closed loops, attraction and motors change no energy, or only give it where an input acts."""
    system = get(name)
    state = rng.uniform(-1, 1, (40, len(system.state_names)))
    rates = friction_rates(free_points(len(system.keypoints)), system, (system.landmarks(state), state), state)
    assert rates is not None and abs(rates["true"]) < 1e-4 and rates["found"] == 0.0


def test_viscous_and_dry_friction_add_up(rng):
    """A bead of 0.5 kg with 0.08 N s/m and 0.06 N, which takes 0.06 |v| watts at speeds far above 0.05 m/s."""
    system, speed = get("zoo/tilted_bead"), 1.5
    state = np.stack([rng.uniform(0, 0.5, 40), np.full(40, speed)], axis=1)
    rates = friction_rates(free_points(1), system, (system.landmarks(state), state), state)
    later = np.array([system.simulate(each, np.zeros(0), 1).state[0, 1] for each in state])
    wanted = 0.08 / 0.5 + 0.06 * np.mean(later) / (0.5 * np.mean(later**2))
    assert rates is not None
    np.testing.assert_allclose(rates["true"], wanted, rtol=1e-4)
