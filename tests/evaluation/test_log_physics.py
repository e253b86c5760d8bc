"""A rig with encoders: what its log shows of inertia, weight and friction."""

import math

import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld.data.imports.log import read_log
from keycld.evaluation import identify_log, physics_table
from keycld.mechanics import load_constraints

DT, SAMPLES = 1 / 250, 2000
INERTIA, WEIGHT, VISCOUS, DRY, OFFSET = 0.06, 1.0, 0.05, 0.2, -0.08


def torque(k):
    return 1.2 * math.sin(0.6 * k * DT * (1 + 0.3 * k * DT)) + 0.4 * math.sin(9 * k * DT)


def logged(path, *, every=1, noise=0.2, digits=4, dry=DRY):
    """J q̈ = τ − G sin q − b q̇ − c q̇/√(q̇² + ε²) − o, by small steps; each torque is held for so many samples."""
    q, rate, rows, fine = 0.0, 0.0, [], 20
    rng = np.random.default_rng(0)
    for k in range(SAMPLES):
        push = torque(k // every * every)
        if k % every == 0:
            rows.append((k * DT, round(q, digits), push + noise * rng.standard_normal()))
        for _ in range(fine):
            friction = VISCOUS * rate + dry * rate / math.hypot(rate, 0.05)
            rate += DT / fine * (push - WEIGHT * math.sin(q) - friction - OFFSET) / INERTIA
            q += DT / fine * rate
    path.write_text("time,position,torque\n" + "".join(f"{t:.6f},{q},{u}\n" for t, q, u in rows))
    return path


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Torques with 20 % noise, encoder steps of 1e-4."""
    return logged(tmp_path_factory.mktemp("rig") / "log.csv")


def test_inertia_weight_and_friction_of_a_rig(rig):
    found = identify_log(read_log(rig, ("position",), ("torque",)), load_constraints("pendulum"), "pendulum")
    constants = found.physics["constants"]
    truth = {
        "inertia": INERTIA,
        "gravity_torque": WEIGHT,
        "viscous_friction": VISCOUS,
        "dry_friction": DRY,
        "torque_offset": OFFSET,
    }
    assert constants.keys() == truth.keys()
    for name, value in truth.items():
        assert abs(constants[name]["value"] - value) < 3.5 * constants[name]["sigma"] + 0.01 * abs(value), name
    assert constants["inertia"]["value"] == pytest.approx(INERTIA, rel=0.1)
    assert constants["gravity_torque"]["value"] == pytest.approx(WEIGHT, rel=0.1)
    assert "inertia" in physics_table(found.physics)


def test_torques_that_are_held_for_long_bring_no_friction(tmp_path):
    """At 50 Hz half a sample of delay would look like a friction of τ̇/2f: here −0.03."""
    log = read_log(logged(tmp_path / "log.csv", every=5, noise=0.0, digits=9, dry=0.0), ("position",), ("torque",))
    constants = identify_log(log, load_constraints("pendulum"), "pendulum").physics["constants"]
    assert constants["viscous_friction"]["value"] == pytest.approx(VISCOUS, abs=0.003)
    assert constants["dry_friction"]["value"] == pytest.approx(0.0, abs=0.003)


def driven(path, acceleration, positions):
    """Two coordinates at most under a force on the first one, held for each sample at 100 Hz; small steps."""
    dt, fine, rows = 0.01, 40, []
    q, rate = np.zeros((2, len(positions)))
    for k in range(2000):
        push = 4 * math.sin(0.05 * k) + 3 * math.sin(0.011 * k + 1) + 2 * math.sin(0.13 * k)
        rows.append((k * dt, *q, push))
        for _ in range(fine):
            rate = rate + dt / fine * acceleration(q, rate, push)
            q = q + dt / fine * rate
    lines = [",".join(f"{number:.9g}" for number in row) for row in rows]
    path.write_text("\n".join([f"time,{','.join(positions)},force", *lines]))
    return read_log(path, positions, ("force",))


@pytest.mark.slow
def test_a_cart_with_a_pole(tmp_path):
    """A slide has no weight, and units of its own."""
    cart, bob, length, b, c = 1.2, 0.3, 0.5, 0.8, 0.01

    def acceleration(q, rate, push):
        coupling = bob * length * math.cos(q[1])
        inertia = np.array([[cart + bob, coupling], [coupling, bob * length**2]])
        force = push - b * rate[0] + bob * length * rate[1] ** 2 * math.sin(q[1])
        torque = -bob * 9.81 * length * math.sin(q[1]) - c * rate[1]
        return np.linalg.solve(inertia, np.array([force, torque]))

    log = driven(tmp_path / "log.csv", acceleration, ("place", "angle"))
    found = identify_log(log, load_constraints("cart-pole"), "cart-pole", lengths=(1.0, length)).physics["constants"]
    truth = {
        "inertia_1_1": (cart + bob, "kg"),
        "inertia_1_2": (bob * length, "kg m"),
        "inertia_2_2": (bob * length**2, "kg m²"),
        "gravity_torque_2": (bob * 9.81 * length, "N m"),
        "viscous_friction_1": (b, "N s/m"),
        "viscous_friction_2": (c, "N m s"),
    }
    for name, (value, unit) in truth.items():
        assert found[name]["value"] == pytest.approx(value, rel=0.02) and found[name]["unit"] == unit, name
    assert found["stiffness_1"]["value"] == pytest.approx(0.0, abs=0.03) and found["stiffness_1"]["unit"] == "N/m"
    assert "gravity_torque_1" not in found and "stiffness_2" not in found


def test_a_mass_on_a_spring(tmp_path):
    mass, stiffness, b = 0.5, 20.0, 0.4
    log = driven(tmp_path / "log.csv", lambda q, v, push: (push - stiffness * (q - 0.03) - b * v) / mass, ("place",))
    found = identify_log(log, load_constraints("spring"), "spring").physics["constants"]
    for name, value in {"inertia": mass, "stiffness": stiffness, "viscous_friction": b}.items():
        assert found[name]["value"] == pytest.approx(value, rel=0.02), name
    assert found["torque_offset"]["value"] == pytest.approx(-0.03 * stiffness, rel=0.02)


def test_the_rest_of_the_log_is_predicted_from_its_torques(rig):
    found = identify_log(read_log(rig, ("position",), ("torque",)), load_constraints("pendulum"), "pendulum")
    off = np.abs(found.predicted - found.measured)
    assert np.median(off) < 0.1 * np.ptp(found.measured)
    assert np.mean(off < 3 * found.sigma + 1e-3) > 0.9


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("torque", "tau", 1), "unknown column"),
        (lambda text: text.replace("\n", "\n0.0,nan,0.0\n", 1), "must have a number"),
        (lambda text: "\n".join(text.split("\n")[:300] + text.split("\n")[700:]), "uneven"),
        (lambda text: "\n".join(text.split("\n")[:9]), "are the least"),
        (lambda text: "", "the file is empty"),
        (lambda text: text.replace("torque", "position", 1), "'position' is named twice"),
    ],
)
def test_a_wrong_log_is_one_sentence(rig, tmp_path, change, message):
    path = tmp_path / "wrong.csv"
    path.write_text(change(rig.read_text()))
    with pytest.raises(KeycldError, match=message):
        read_log(path, ("position",), ("torque",))


def test_no_column_is_read_twice(rig):
    with pytest.raises(KeycldError, match="'position' is named twice"):
        read_log(rig, ("position", "position"), ("torque",))


def test_columns_that_do_not_fit_the_mechanism(rig):
    log = read_log(rig, ("position",), ("torque",))
    with pytest.raises(KeycldError, match="has 2 joints"):
        identify_log(log, load_constraints("double-pendulum"), "double-pendulum")
    with pytest.raises(KeycldError, match="--input"):
        identify_log(log._replace(u=log.u[:, :0]), load_constraints("pendulum"), "pendulum")


def test_an_encoder_may_begin_again_after_each_turn(rig):
    log = read_log(rig, ("position",), ("torque",))
    assert log.q.max() > 2 * np.pi
    plain, jumping = (
        identify_log(log._replace(q=q), load_constraints("pendulum"), "pendulum") for q in (log.q, log.q % (2 * np.pi))
    )
    np.testing.assert_allclose(jumping.measured, plain.measured, atol=1e-12)
    assert jumping.physics["constants"]["inertia"]["value"] == pytest.approx(
        plain.physics["constants"]["inertia"]["value"], rel=1e-6
    )


def test_torques_that_have_nothing_to_do_with_the_motion_tell_nothing(rig):
    """No inertia, and no prediction by a law that diverges."""
    log = read_log(rig, ("position",), ("torque",))
    noise = np.random.default_rng(1).normal(0, 0.01, log.u.shape)
    physics = identify_log(log._replace(u=noise), load_constraints("pendulum"), "pendulum").physics
    assert physics["constants"]["inertia"]["value"] is None and not physics["constants"]["inertia"]["identifiable"]
    assert physics["prediction"] == {} and "diverges" in physics["note"] and physics["note"] in physics_table(physics)
