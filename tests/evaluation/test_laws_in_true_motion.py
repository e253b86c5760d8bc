"""A law that is known exactly, held to the true motion of a damped pendulum."""

import jax.numpy as jnp
import numpy as np
import pytest

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
from keycld.systems import get

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


@pytest.mark.parametrize("friction", [0.0, 0.5 * FRICTION, FRICTION])
def test_friction_of_a_hinge_has_the_rate_c_over_j(rng, friction):
    """Whatever the motion."""
    state = np.stack([rng.uniform(-np.pi, np.pi, 200), rng.uniform(-6, 6, 200)], axis=1)
    rates = friction_rates(pendulum(friction), SYSTEM, (SYSTEM.landmarks(state), state), state[:50])
    assert rates is not None
    np.testing.assert_allclose(rates["true"], FRICTION / INERTIA, rtol=1e-6)
    np.testing.assert_allclose(rates["found"], friction / INERTIA, rtol=1e-3, atol=1e-6)
