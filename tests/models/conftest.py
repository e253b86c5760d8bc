import pytest

from keycld.mechanics import (
    ConstrainedLagrangian,
    Constraints,
    DistanceToPoint,
    MechanicalDynamics,
    PointMasses,
    Rattle,
)


@pytest.fixture(scope="module")
def pendulum():
    """A bob of mass one on a rod of length one, known exactly."""
    law = ConstrainedLagrangian(
        PointMasses.ones(1), lambda x: 9.81 * x[1], None, Constraints(("bob",), (DistanceToPoint("bob"),))
    )
    return MechanicalDynamics(law, Rattle(substeps=4))
