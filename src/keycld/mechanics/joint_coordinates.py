"""Joints of chains, the coordinates that encoders measure and motors drive, and where they put keypoints."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics.constraints import AbstractConstraint, Constraints
from keycld.mechanics.relations.distance_to_point import DistanceToPoint
from keycld.mechanics.relations.fixed_distance import FixedDistance
from keycld.mechanics.relations.on_line import OnLine


class Joint(eqx.Module):
    """One joint: a hinge at the near end of a link, or a slide.

    Attributes:
        keypoint: index of the keypoint that it moves.
        parent: index of the keypoint that the hinge is at; None for a fixed pivot or a slide.
        slide: whether it is a slide.
        place: pivot or direction (dx, dy) of unit length of the slide.
    """

    keypoint: int = eqx.field(static=True)
    parent: int | None = eqx.field(static=True)
    slide: bool = eqx.field(static=True)
    place: tuple[float, float] = eqx.field(static=True)


def joints_of(constraint: AbstractConstraint) -> tuple[Joint, ...]:
    """Return the joints of a chain, one a keypoint, from the ground outward.

    Raises:
        KeycldError: the mechanism is no open chain of links and slides.
    """
    if not isinstance(constraint, Constraints):
        raise KeycldError("joints are those of named constraints, not of a function: describe the mechanism in TOML.")
    found: list[Joint] = []
    for item in constraint.items:
        if isinstance(item, DistanceToPoint):
            x, y = (float(number) for number in np.asarray(item.origin({})))
            found.append(Joint(constraint.keypoints.index(item.keypoint), None, False, (x, y)))
        elif isinstance(item, OnLine):
            x, y = (float(number) for number in np.asarray(item.normal))
            found.append(Joint(constraint.keypoints.index(item.keypoint), None, True, (y, -x)))
        elif isinstance(item, FixedDistance):
            ends = [constraint.keypoints.index(name) for name in (item.first, item.second)]
            held = {joint.keypoint for joint in found}
            near = next((end for end in ends if end in held), None)
            if near is None:
                raise KeycldError(
                    f"the link {item.first}–{item.second} hangs on nothing: name its joints from the ground."
                )
            found.append(Joint(ends[0] + ends[1] - near, near, False, (0.0, 0.0)))
        else:
            raise KeycldError(f"{type(item).__name__} is no joint: describe the mechanism by links and slides alone.")
    moved = [joint.keypoint for joint in found]
    if sorted(moved) != list(range(len(constraint.keypoints))):
        raise KeycldError("joints are those of an open chain, in which each keypoint has one link or slide.")
    return tuple(found)


def joint_positions(joints: tuple[Joint, ...], q: Float[Array, "d"], lengths: Float[Array, "d"]) -> Float[Array, "dim"]:
    """Return keypoints `[2K]` for joint coordinates.

    Args:
        joints: of the chain.
        q: angles of hinges, rad, counter-clockwise: the first link of a chain against straight down, each other one
            against the link before; displacements of slides.
        lengths: of the links, any unit; those of slides do not count.
    """
    points: dict[int, Array] = {}
    turned: dict[int, Array] = {}
    for k, joint in enumerate(joints):
        place = jnp.array(joint.place, q.dtype)
        if joint.slide:
            points[joint.keypoint], turned[joint.keypoint] = place * q[k], jnp.zeros((), q.dtype)
            continue
        angle = q[k] + (0.0 if joint.parent is None else turned[joint.parent])
        along = lengths[k] * jnp.stack([jnp.sin(angle), -jnp.cos(angle)])
        points[joint.keypoint] = (place if joint.parent is None else points[joint.parent]) + along
        turned[joint.keypoint] = angle
    return jnp.concatenate([points[k] for k in sorted(points)])
