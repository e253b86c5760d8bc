"""Physical constants of a mechanism by name, each a function of the law and of the constants of Φ."""

import itertools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics.constraints import AbstractConstraint, Constraints
from keycld.mechanics.force import SumPotential, terms_of
from keycld.mechanics.forces.coulomb import CoulombFriction
from keycld.mechanics.lagrangian import ConstrainedLagrangian
from keycld.mechanics.relation import AbstractRelation
from keycld.mechanics.relations.distance_to_point import DistanceToPoint
from keycld.mechanics.relations.fixed_distance import FixedDistance
from keycld.mechanics.rest_pose import RestPose, coulomb_decelerations, oscillations, viscous_rate

PIVOT = "pivot"
"""The fixed end of a link, in the names of lengths."""
# Terms of V that act on keypoints like gravity does.
_LIKE_WEIGHT = frozenset({"springs", "anchors", "perceptron", "perceptron-32"})


class Scale(NamedTuple):
    """What makes image-plane units metres: a known length, or the strength of gravity. Its own error is not counted.

    Attributes:
        between: the ends of the length, two keypoints, or "pivot" and a keypoint; None for gravity.
        value: metres, or m/s².
    """

    between: tuple[str, str] | None
    value: float


def lengths_of(constraint: AbstractConstraint, constants: Float[Array, "n"]) -> dict[tuple[str, str], Array]:
    """Return the lengths that the constraints keep, image-plane units, by their ends."""
    if not isinstance(constraint, Constraints):
        return {}
    found, row = {}, 0
    for item in constraint.items:
        ends = _ends(item)
        if ends is not None:
            found[ends] = jnp.sqrt(constants[row]) if constraint.squared else constants[row]
        row += 1 if isinstance(item, AbstractRelation) else item.count
    return found


def physical_constants(
    law: ConstrainedLagrangian, constants: Float[Array, "n"], pose: RestPose | None, scale: Scale | None = None
) -> dict[str, Array]:
    """Return all physical constants by name (docs/physics.md). Nothing depends on the common factor of M, V and R.

    Args:
        law: M, V, R, Φ.
        constants: values of Φ.
        pose: the stable rest pose; without one there are neither periods nor a viscous rate.
        scale: for constants in metres as well.

    Raises:
        KeycldError: the scale is a length that no constraint keeps, or gravity where no keypoint shows it.
    """
    found = _geometry(law.constraint_function)
    lengths = lengths_of(law.constraint_function, constants)
    found |= {"_".join(("length", *ends)): length for ends, length in lengths.items()}
    found |= _mass_ratios(law)
    if pose is not None:
        small = oscillations(law, constants, pose)
        found |= {f"period_{k + 1}": small.periods[k] for k in range(small.periods.shape[0])}
        if any(getattr(term, "viscous", False) for term in terms_of(law).values()):
            found["viscous_rate"] = viscous_rate(law, constants, pose)
            found |= {f"damping_ratio_{k + 1}": small.damping_ratios[k] for k in range(small.periods.shape[0])}
        dry = terms_of(law).get(CoulombFriction.kind)
        if isinstance(dry, CoulombFriction):
            slowed = coulomb_decelerations(law, constants, pose, dry)
            found |= {f"coulomb_deceleration_{k + 1}": slowed[k] for k in range(slowed.shape[0])}
    if isinstance(law.potential, SumPotential) and not _LIKE_WEIGHT & law.potential.terms.keys():
        weights = law.potential.weight.reshape(-1, 2)
        down = -jnp.sum(weights, axis=0)
        found["gravity_direction"] = jnp.rad2deg(jnp.arctan2(down[1], down[0]))
        found["gravity"] = jnp.linalg.norm(weights[-1]) / law.masses[-1]
    return found if scale is None else found | _in_metres(found, lengths, scale)


def _mass_ratios(law: ConstrainedLagrangian) -> dict[str, Array]:
    """Return the ratio of the masses at each keypoint and the next one.

    Links in a row that hang on a pivot have inertias N, which multiply cos(θ_i − θ_j) in the kinetic energy. Point
    masses m would have N_{i,i+1}² / (N_ii N_{i+1,i+1}) = s_{i+1} / s_i, with s_i = m_i + m_{i+1} + …; their ratios do
    not depend on how long the links are, and so not on where on the last one its keypoint is. The sums of the rows of
    M do: of two equal masses their ratio is a tenth off where the keypoint is a twentieth of the link too near. Other
    mechanisms have these sums: how a pole swings on a cart tells its inertia ten times less exactly than the momentum
    that it takes from the cart.
    """
    constraint, matrix = law.constraint_function, law.mass.matrix
    if not isinstance(constraint, Constraints):
        return {}
    names, ratios = constraint.keypoints, law.masses[:-1] / law.masses[1:]
    if len(names) > 1 and _hangs_in_a_row(constraint):
        inertia = jnp.cumsum(jnp.cumsum(matrix[::-1, ::-1], axis=0), axis=1)[::-1, ::-1]
        own, next_ = jnp.diagonal(inertia), jnp.diagonal(inertia, offset=1)
        beyond = next_**2 / (own[:-1] * own[1:])
        ratios = (1 / beyond - 1) / (1 - jnp.append(beyond[1:], 0.0))
    return {f"mass_ratio_{names[k]}_{names[k + 1]}": ratios[k] for k in range(len(names) - 1)}


def _hangs_in_a_row(constraint: Constraints) -> bool:
    """Tell whether the first keypoint turns around a pivot, each other one around the one before, and nothing else."""
    names = constraint.keypoints
    links = [{item.first, item.second} for item in constraint.items if isinstance(item, FixedDistance)]
    others = [item for item in constraint.items if not isinstance(item, FixedDistance)]
    hinged = [item.keypoint for item in others if isinstance(item, DistanceToPoint)]
    pairs = [set(pair) for pair in itertools.pairwise(names)]
    return hinged == [names[0]] and len(others) == 1 and len(links) == len(pairs) and all(p in links for p in pairs)


def _geometry(constraint: AbstractConstraint) -> dict[str, Array]:
    """Return what is learned of pivots and of the directions of lines."""
    unknowns, found = constraint.unknowns, {}
    pivots = [name for name in unknowns if name.startswith("pivot_")]
    for name in pivots:
        own = "pivot" if len(pivots) == 1 else name
        found |= {f"{own}_x": unknowns[name][0], f"{own}_y": unknowns[name][1]}
    for name in unknowns.keys() - set(pivots):
        if name.startswith("angle_"):
            found[name.replace("angle_", "line_direction_", 1)] = jnp.rad2deg(unknowns[name])
    return found


def _in_metres(found: dict[str, Array], lengths: dict[tuple[str, str], Array], scale: Scale) -> dict[str, Array]:
    if scale.between is None:
        if "gravity" not in found:
            raise KeycldError("gravity gives no scale here, because it acts like the springs: give a length.")
        metres = scale.value / found["gravity"]
    else:
        length = next((value for ends, value in lengths.items() if {*ends} == {*scale.between}), None)
        if length is None:
            known = ", ".join("–".join(ends) for ends in lengths) or "none"
            raise KeycldError(
                f"no length {'–'.join(scale.between)} is constant in this mechanism: choose from {known}."
            )
        metres = scale.value / length
    in_metres = {f"{name}_m": value * metres for name, value in found.items() if name.startswith("length_")}
    if "gravity" in found:
        in_metres["gravity_m"] = found["gravity"] * metres
    return in_metres | {"metres_per_unit": metres}


def _ends(item: object) -> tuple[str, str] | None:
    if isinstance(item, FixedDistance):
        return item.first, item.second
    return (PIVOT, item.keypoint) if isinstance(item, DistanceToPoint) else None
