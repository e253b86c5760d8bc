"""The fixed-step integrators of first-order equations that have a name."""

import dataclasses

from keycld._errors import unknown
from keycld.mechanics.integrators import AbstractIntegrator
from keycld.mechanics.runge_kutta import RungeKutta
from keycld.mechanics.symplectic import Composition


def _symmetric(first: tuple[float, ...], count: int) -> tuple[float, ...]:
    """Extend the first half of `count` coefficients to a palindrome of sum 1."""
    rest = 1 - 2 * sum(first)
    middle = (rest,) if count % 2 else (rest / 2, rest / 2)
    return (*first, *middle, *reversed(first))


def _leapfrogs(first: tuple[float, ...], count: int) -> Composition:
    """Return `count` leapfrog steps of lengths that make a palindrome; neighbouring half kicks are merged."""
    lengths = _symmetric(first, count)
    halves = (0.0, *lengths, 0.0)
    kicks = tuple((before + after) / 2 for before, after in zip(halves[:-1], halves[1:], strict=True))
    return Composition(kicks=kicks, drifts=lengths, kick_first=True)


_CUBE_ROOT = 2 ** (1 / 3)

INTEGRATORS: dict[str, AbstractIntegrator] = {
    "euler": RungeKutta(rows=((),), weights=(1.0,)),
    # Mid-point rule.
    "rk2": RungeKutta(rows=((), (1 / 2,)), weights=(0.0, 1.0)),
    "rk4": RungeKutta(rows=((), (1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0)), weights=(1 / 6, 1 / 3, 1 / 3, 1 / 6)),
    # Kutta's 3/8 rule.
    "rk38": RungeKutta(rows=((), (1 / 3,), (-1 / 3, 1.0), (1.0, -1.0, 1.0)), weights=(1 / 8, 3 / 8, 3 / 8, 1 / 8)),
    "symp_euler": Composition(kicks=(1.0,), drifts=(1.0,), kick_first=False),
    "leap_frog": Composition(kicks=(0.5, 0.5), drifts=(1.0,), kick_first=True),
    # Forest and Ruth 1990.
    "ruth4": Composition(
        kicks=_symmetric((1 / (2 - _CUBE_ROOT),), 3),
        drifts=_symmetric((1 / (4 - 2 * _CUBE_ROOT),), 4),
        kick_first=False,
    ),
    # Blanes and Moan 2002: S6 of order 4 and S10 of order 6.
    "sym4": Composition(
        kicks=_symmetric((0.0792036964311957, 0.353172906049774, -0.0420650803577195), 7),
        drifts=_symmetric((0.209515106613362, -0.143851773179818), 6),
        kick_first=True,
    ),
    "sym6": Composition(
        kicks=_symmetric(
            (0.0502627644003922, 0.413514300428344, 0.0450798897943977, -0.188054853819569, 0.54196067845078), 11
        ),
        drifts=_symmetric((0.148816447901042, -0.132385865767784, 0.067307604692185, 0.432666402578175), 10),
        kick_first=True,
    ),
    # McLachlan 1995 and Yoshida 1990.
    "so4": _leapfrogs((0.28, 0.62546642846767004501), 5),
    "so6": _leapfrogs((0.78451361047755726382, 0.23557321335935813368, -1.17767998417887100695), 7),
    "so8": _leapfrogs(
        (
            0.74167036435061295345,
            -0.409100825800031594,
            0.19075471029623837995,
            -0.57386247111608226666,
            0.29906418130365592384,
            0.33462491824529818378,
            0.31529309239676659663,
        ),
        15,
    ),
}


def integrator_named(name: str, substeps: int = 1) -> AbstractIntegrator:
    """Return a fixed-step integrator of first-order equations.

    Runge–Kutta methods follow any field: `euler` (order 1), `rk2` (2), `rk4` and `rk38` (4). Symplectic compositions
    follow a `SeparableHamiltonian`: `symp_euler` (1, position first), `leap_frog` (2, momentum first), `ruth4`, `sym4`,
    `so4` (4), `sym6`, `so6` (6), `so8` (8).

    Args:
        name: one of these.
        substeps: steps a frame.

    Raises:
        KeycldError: for an unknown name or less than one sub-step.
    """
    if name not in INTEGRATORS:
        raise unknown("integrator", name, INTEGRATORS)
    return dataclasses.replace(INTEGRATORS[name], substeps=substeps)
