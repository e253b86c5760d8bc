"""A thousand initial states of each set follow the documented distributions (Kolmogorov–Smirnov, seeds fixed)."""

from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chisquare, kstest

from keycld.systems import AbstractInitialValueSystem, get, names
from keycld.systems.hamiltonian.base import AbstractHamiltonianSystem
from keycld.systems.rooms.base import AbstractRoom

COUNT = 1000
NAMES = names(AbstractInitialValueSystem)
TOYS = names(AbstractHamiltonianSystem)
VARIED = tuple(name for name in TOYS if "colors" in name)
# Some 160 comparisons are made here.
LEAST = 1e-3 / 160
RANGES = {
    "mass_spring": {"k": (2, 2), "m": (0.5, 0.5)},
    "mass_spring_colors": {"k": (2, 2), "m": (0.2, 1.0)},
    "pendulum": {"m": (0.5, 0.5), "g": (3, 3), "l": (1, 1)},
    "pendulum_colors": {"m": (0.5, 1.5), "g": (3, 4), "l": (0.5, 1)},
    "double_pendulum": {"m_1": (0.5, 0.5), "m_2": (0.5, 0.5), "l_1": (1, 1), "l_2": (1, 1), "g": (3, 3)},
    "double_pendulum_colors": {"m_1": (0.4, 0.6), "m_2": (0.4, 0.6), "l_1": (0.75, 1), "l_2": (0.75, 1), "g": (2.5, 4)},
    "two_body": {"m": (1, 1), "g": (1, 1)},
    "two_body_colors": {"m": (0.5, 1.5), "g": (0.5, 1.5)},
}  # fmt: skip
RADII = {"mass_spring": (0.1, 1.0), "pendulum": (1.3, 2.3), "double_pendulum": (1.3, 2.3)}


@lru_cache
def starts(name, protocol="priors-released"):
    system = get(name)
    sampled = [system.initial_state(np.random.RandomState(seed), protocol) for seed in range(COUNT)]
    return np.stack([state for state, _ in sampled]), {
        key: np.stack([p[key] for _, p in sampled]) for key in sampled[0][1]
    }


def kind(name):
    return name.split("/")[1].removesuffix("_friction")


def follows(sample, low, high):
    """Whether a sample is uniform between two values, or constant where they are the same."""
    if low == high:
        return bool(np.all(sample == low))
    return kstest(np.ravel(sample), "uniform", (low, high - low)).pvalue > LEAST


def annulus(name, state, parameters):
    """Distance from the origin, and angle, of each (q, p) that was sampled from a ring."""
    n = state.shape[1] // 2
    scale = np.sqrt(parameters["k"] * parameters["m"]) if "mass_spring" in name else np.ones(len(state))
    q, p = state[:, :n], state[:, n:] / scale[:, None]
    return np.hypot(q, p), np.arctan2(p, q)


@pytest.mark.parametrize("name", TOYS)
def test_parameters(name):
    _, parameters = starts(name)
    wanted = RANGES[kind(name)]
    assert set(parameters) == {*wanted, "color_index", "offset", "canvas"}
    for key, (low, high) in wanted.items():
        assert follows(parameters[key], low, high), key
    values = [parameters[key].reshape(COUNT, -1) for key, (low, high) in wanted.items() if low < high]
    if values:
        mixed = np.corrcoef(np.concatenate(values, axis=1), rowvar=False)
        assert np.abs(np.atleast_2d(mixed) - np.eye(len(np.atleast_2d(mixed)))).max() < 0.15


@pytest.mark.parametrize("name", [name for name in TOYS if "body" not in name])
@pytest.mark.parametrize("protocol", ["priors-released", "priors-paper"])
def test_starts_in_a_ring(name, protocol):
    radius, angle = annulus(name, *starts(name, protocol))
    low, high = RADII[kind(name).removesuffix("_colors")]
    if "double_pendulum_colors" in name and protocol == "priors-released":
        low, high = 1.0, 2.5
    by_area = "colors" in name or protocol == "priors-paper"
    power = 2 if by_area else 1
    for column in range(radius.shape[1]):
        assert follows(radius[:, column] ** power, low**power, high**power)
        assert follows(angle[:, column], -np.pi, np.pi)


def test_a_ring_by_area_differs_from_one_by_radius():
    radius, _ = annulus("toy/pendulum", *starts("toy/pendulum"))
    assert not follows(radius**2, 1.3**2, 2.3**2)


@pytest.mark.parametrize("name", ["toy/two_body", "toy/two_body_colors"])
def test_two_bodies_start_on_one_line(name):
    state, _ = starts(name)
    assert follows(state[:, 0], 0.5, 1.5) and follows(state[:, 1], 0.5, 1.5)
    np.testing.assert_array_equal(state[:, 2:4], -state[:, :2])
    np.testing.assert_array_equal(state[:, 6:], -state[:, 4:6])
    assert np.abs(np.sum(state[:, :2] * state[:, 4:6], axis=1)).max() < 1e-12
    np.testing.assert_allclose(np.hypot(*state[:, 4:6].T), 0.5 / np.sqrt(np.hypot(*state[:, :2].T)))


@pytest.mark.parametrize("name", TOYS)
def test_energies(name):
    """Compared with an independent sample of the documented distributions."""
    state, parameters = starts(name)
    energy = get(name).all_conserved(state[:, None], parameters)[:, 0]
    random = np.random.RandomState(20211109)
    p = {key: random.uniform(*limits, (20_000, 2)) for key, limits in RANGES[kind(name)].items()}
    m, g = p["m"][:, 0] if "m" in p else p["m_1"][:, 0], p["g"][:, 0] if "g" in p else 0.0
    low, high = RADII.get(kind(name).removesuffix("_colors"), (0.0, 0.0))
    if "double_pendulum_colors" in name:
        low, high = 1.0, 2.5
    uniform = random.uniform(size=(20_000, 2))
    r = np.sqrt(low**2 + uniform * (high**2 - low**2)) if "colors" in name else low + uniform * (high - low)
    angle = random.uniform(-np.pi, np.pi, (20_000, 2))
    (q, q2), (v, v2) = (r * np.cos(angle)).T, (r * np.sin(angle)).T
    if "spring" in name:
        wanted = p["k"][:, 0] * r[:, 0] ** 2 / 2
    elif "body" in name:
        distance = np.hypot(*random.uniform(0.5, 1.5, (2, 20_000)))
        m1, m2 = p["m"].T
        wanted = (1 / m1 + 1 / m2) / (8 * distance) - g * m1 * m2 / (2 * distance)
    elif "double" in name:
        m2, l1, l2 = p["m_2"][:, 0], p["l_1"][:, 0], p["l_2"][:, 0]
        # Kinetic energy p M⁻¹ p / 2 with the mass matrix of the absolute angles.
        mass = np.stack(
            [[(m + m2) * l1**2, m2 * l1 * l2 * np.cos(q - q2)], [m2 * l1 * l2 * np.cos(q - q2), m2 * l2**2]]
        ).transpose(2, 0, 1)
        momenta = np.stack([v, v2], axis=-1)
        kinetic = np.sum(momenta * np.linalg.solve(mass, momenta[..., None])[..., 0], axis=1) / 2
        wanted = kinetic - (m + m2) * g * l1 * np.cos(q) - m2 * g * l2 * np.cos(q2)
    else:
        length = p["l"][:, 0]
        wanted = m * g * length * (1 - np.cos(q)) + v**2 / (2 * m * length**2)
    assert kstest(energy, wanted).pvalue > LEAST


@pytest.mark.parametrize("name", TOYS)
def test_colours(name):
    index, hues, n = starts(name)[1]["color_index"], get(name).hues, 2 if "body" in name or "double" in name else 1
    assert index.shape == (COUNT, n) and index.min() >= 0 and index.max() < hues
    if n == 2:
        assert np.all(index[:, 0] != index[:, 1])
    pairs, counts = np.unique(index, axis=0, return_counts=True)
    assert len(pairs) == (hues if n == 1 else hues * (hues - 1))
    assert len(pairs) == 1 or chisquare(counts).pvalue > LEAST


@pytest.mark.parametrize("name", TOYS)
def test_places(name):
    _, released = starts(name)
    reach = 0.4 * get(name).half_width
    x, y = released["offset"].T
    if "mass_spring_colors" in name:
        # The released generator shifts both axes by one number, and x by U(0, 1) more.
        assert follows(y, -reach, reach) and follows(x - y, 0.0, 1.0)
    elif name in VARIED and "body" not in name:
        assert follows(x, -reach, reach) and follows(y, -reach, reach) and abs(np.corrcoef(x, y)[0, 1]) < 0.15
    else:
        assert not np.any(released["offset"])


@pytest.mark.parametrize("name", TOYS)
def test_the_papers_text_is_a_switch(name):
    _, paper = starts(name, "priors-paper")
    x, y = paper["offset"].T
    reach = 0.4 * get(name).half_width
    if name in VARIED:
        assert follows(x, -reach, reach) and follows(y, -reach, reach) and abs(np.corrcoef(x, y)[0, 1]) < 0.15
        np.testing.assert_allclose(paper["canvas"], 1.4 * get(name).half_width)
    else:
        assert not np.any(paper["offset"]) and len(np.unique(paper["color_index"], axis=0)) == 1


@pytest.mark.parametrize("name", sorted(set(NAMES) - set(TOYS)))
def test_strategies_are_uniform_on_the_simplex(name):
    state, _ = starts(name)
    n = state.shape[1] // 2
    for player in (state[:, :n], state[:, n:]):
        np.testing.assert_allclose(player.sum(axis=1), 1.0)
        for share in player.T:
            # One share of a uniform point of the simplex has the distribution function 1 − (1 − x)ⁿ⁻¹.
            assert follows(1 - (1 - share) ** (n - 1), 0.0, 1.0)
    assert abs(np.corrcoef(state[:, 0], state[:, n])[0, 1]) < 0.15


@pytest.mark.parametrize("name", names(AbstractRoom))
def test_rooms(name):
    recording = get(name).record(range(300), 3, "priors-paper", "default")
    p = recording.parameters
    assert follows(p["radius"], 0.0, 0.9 if "circle" in name else 0.6) and follows(p["angle"], 0.0, 2 * np.pi)
    assert chisquare(np.bincount(p["shape"].ravel(), minlength=4)).pvalue > LEAST
    assert np.all(np.linalg.norm(p["place"], axis=-1) <= 0.65)
    gaps = np.linalg.norm(p["place"][:, :, None] - p["place"][:, None], axis=-1) + np.eye(5)
    assert gaps.min() > 2 * 0.08 and p["color"].min() >= 0 and p["color"].max() <= 1


def test_sets_with_and_without_friction_start_alike():
    with_friction, without = (starts(f"toy/pendulum_colors{more}") for more in ("_friction", ""))
    np.testing.assert_array_equal(with_friction[0], without[0])


def test_no_two_numbers_start_alike():
    """The suite drew its seeds from 63 values."""
    for name in NAMES:
        assert len(np.unique(starts(name)[0], axis=0)) == COUNT
