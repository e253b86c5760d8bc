"""Random distributions that several sets share; every trajectory has a generator `RandomState(number)` of its own."""

import math

import numpy as np
from jaxtyping import Float, Int


def annulus(random: np.random.RandomState, radii: tuple[float, float], *, by_area: bool) -> Float[np.ndarray, "2"]:
    """Sample a point of the ring between two radii.

    `by_area`: uniform over the ring, r = √U(r₁², r₂²); otherwise r = U(r₁, r₂), which favours the inside.
    """
    low, high = radii
    radius = math.sqrt(random.uniform(low**2, high**2)) if by_area else random.uniform(low, high)
    angle = random.uniform(-math.pi, math.pi)
    return radius * np.array([math.cos(angle), math.sin(angle)])


def distinct(random: np.random.RandomState, count: int, among: int) -> Int[np.ndarray, "count"]:
    """Sample `count` different numbers below `among`, every order equally likely."""
    return random.permutation(among)[:count]


def simplex(random: np.random.RandomState, count: int) -> Float[np.ndarray, "count"]:
    """Sample shares that sum to 1, uniformly over all such (Dirichlet, parameters 1): gaps between sorted numbers."""
    cuts = np.sort(random.uniform(size=count - 1))
    return np.diff(np.concatenate([[0.0], cuts, [1.0]]))
