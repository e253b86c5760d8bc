"""An identified chain as a MuJoCo model."""

import dataclasses
from typing import NamedTuple
from xml.etree import ElementTree

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from keycld._errors import KeycldError
from keycld.mechanics.constants import lengths_of
from keycld.mechanics.constraints import Constraints
from keycld.mechanics.force import SumPotential, terms_of
from keycld.mechanics.forces.coulomb import CoulombFriction
from keycld.mechanics.forces.joints import JointFriction, hinged_links
from keycld.mechanics.forces.springs import Springs
from keycld.mechanics.forces.viscous import ViscousFriction
from keycld.mechanics.joint_coordinates import Joint, joints_of
from keycld.mechanics.lagrangian import ConstrainedLagrangian

# A link's mass above the least one that its inertia allows, as a share of what is free: rigid bodies have some inertia.
_SPARE = 0.02
# Distance of the anchors of dampers that resist a keypoint in all directions, in lengths of the mechanism.
_FAR = 1e4
_GIVES = "the friction of this law gives energy, which MuJoCo does not allow: measure it on more motion."
_RIGID = "the masses are not those of rigid bodies: measure them on more recordings."
# Couplings of keypoints without a link between them, as a share of what they have alone, and weights that are not those
# of one gravity, as a share of all weights, that errors explain.
_STRAY = 0.05


@dataclasses.dataclass
class _Part:
    """A rigid body: mass, centre along the link, inertia about it; its joint; name and place of what is resisted."""

    name: str
    joint: Joint
    length: float
    mass: float
    centre: float
    inertia: float
    damping: float = 0.0
    loss: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    resisted: tuple[str, float] | None = None


class _Elements(NamedTuple):
    """The world and the tendons of a model, and the names of its sites."""

    world: ElementTree.Element
    tendons: ElementTree.Element
    sites: set[str]


def to_mjcf(law: ConstrainedLagrangian, constants: Float[np.ndarray, "n"], *, metres: float = 1.0) -> str:
    """Return the MJCF text of a MuJoCo model that moves like a law: an open chain of links and slides.

    x of the image plane is MuJoCo's x, y is its z; joints have the coordinates of `joints_of`. Masses are relative: the
    whole has mass 1, because M, V and R are known up to one factor. A mass matrix of keypoints leaves part of the shape
    of the bodies open; one of those that move alike is written. Each keypoint is a site, with a sensor of its position.
    Inputs are left out: what they do is not a property of the mechanism.

    Args:
        law: M, V, R and constraints.
        constants: values of Φ.
        metres: of one image-plane unit.

    Raises:
        KeycldError: the mechanism is no open chain, or a force or the name of a keypoint cannot be exported.
    """
    constraint = law.constraint_function
    try:
        joints = joints_of(constraint)
    except KeycldError as error:
        reason = str(error).partition(": ")[0].rstrip(".")
        raise KeycldError(
            f"only an open chain of links and slides has a MuJoCo model here ({reason}): export the keypoints with "
            "--to csv."
        ) from error
    assert isinstance(constraint, Constraints)
    for name in constraint.keypoints:
        if not name.isprintable():
            raise KeycldError(
                f"XML has no place for all characters of the keypoint {name!r}: rename it, or export the keypoints "
                "with --to csv."
            )
    values = np.asarray(constants, float)
    known = iter(lengths_of(constraint, jnp.asarray(constants)).values())
    lengths = [0.0 if joint.slide else metres * float(next(known)) for joint in joints]
    matrix = _along_links(np.asarray(law.mass.matrix, float), joints, "masses")
    weights = _weights(law)
    unit = matrix.sum()
    parts, pull = _bodies(constraint.keypoints, joints, lengths, matrix / unit, weights / unit * metres)
    if "springs" not in terms_of(law):
        _check_weights(joints, parts, weights / unit * metres, pull)
    gravity = float(np.linalg.norm(pull))
    root = ElementTree.Element("mujoco", model="keycld")
    # Along a line gravity only shifts where a spring rests; `_springs` puts it there.
    direction = np.zeros(2) if "springs" in terms_of(law) else pull
    # Frequencies of a mechanism that falls in g over its length; the step is a small part of that time.
    reach = max([length for length in lengths if length] or [metres])
    step = min(0.002, 0.005 / np.sqrt(max(gravity, 1e-6) / reach))
    ElementTree.SubElement(
        root, "option", integrator="RK4", timestep=_text(step), gravity=_text(direction[0], 0.0, direction[1])
    )
    world = ElementTree.SubElement(root, "worldbody")
    tendons, sensors = ElementTree.Element("tendon"), ElementTree.Element("sensor")
    _springs(law, parts, unit, metres)
    _friction(law, parts, joints, unit, metres, _Elements(world, tendons, set(constraint.keypoints)))
    bodies: dict[int, ElementTree.Element] = {}
    for k, (part, joint) in enumerate(zip(parts, joints, strict=True)):
        parent = world if joint.parent is None else bodies[joint.parent]
        near = next((p for p in parts if p.joint.keypoint == joint.parent), None)
        if joint.slide:
            place = metres * values[k] * np.array([-joint.place[1], joint.place[0]])
        elif near is None:
            place = metres * np.array(joint.place)
        else:
            place = np.array([0.0, -near.length])
        # MuJoCo keeps one name of a body for itself.
        name = _free_name("world", {"world", *constraint.keypoints}) if part.name == "world" else part.name
        bodies[joint.keypoint] = _body(parent, part, name, place)
        ElementTree.SubElement(sensors, "framepos", name=part.name, objtype="site", objname=part.name)
    root.extend([each for each in (tendons, sensors) if len(each)])
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _weights(law: ConstrainedLagrangian) -> Float[np.ndarray, "K 2"]:
    known = {"springs", "viscous", "joints", "coulomb"}
    if odd := terms_of(law).keys() - known:
        raise KeycldError(
            f"the force '{min(odd)}' cannot be exported to MuJoCo, only {', '.join(sorted(known))} can: train with "
            "some of these, such as --terms springs viscous, or export the keypoints with --to csv."
        )
    if not isinstance(law.potential, SumPotential):
        raise KeycldError("only a potential energy of named forces can be exported: train with the preset fast.")
    return np.asarray(law.potential.weight, float).reshape(-1, 2)


def _direction(weights: np.ndarray) -> np.ndarray:
    """Return the direction of gravity, straight down without any."""
    total = -weights.sum(axis=0)
    size = np.linalg.norm(total)
    return total / size if size > 1e-9 else np.array([0.0, -1.0])


def _along_links(matrix: np.ndarray, joints: tuple[Joint, ...], what: str) -> np.ndarray:
    """Return a symmetric matrix of keypoints without couplings of those that no link joins: MuJoCo has none."""
    linked = np.eye(len(matrix), dtype=bool)
    for joint in joints:
        if joint.parent is not None:
            linked[joint.keypoint, joint.parent] = linked[joint.parent, joint.keypoint] = True
    alone = np.sqrt(np.abs(np.diagonal(matrix)))
    if np.any(np.abs(matrix[~linked]) > _STRAY * np.outer(alone, alone)[~linked]):
        raise KeycldError(
            f"the {what} couple keypoints without a link between them, which MuJoCo does not: measure them on more "
            "recordings, or export the keypoints with --to csv."
        )
    return np.where(linked, matrix, 0.0)


def _bodies(
    names: tuple[str, ...], joints: tuple[Joint, ...], lengths: list[float], matrix: np.ndarray, weights: np.ndarray
) -> tuple[list[_Part], np.ndarray]:
    """Return rigid bodies with this mass matrix and these weights, and gravity as a vector.

    A link with mass μ, first moment h l and inertia m l² about its near end adds μ − 2h + m, h − m and m to the mass
    matrix, and g (μ − h), g h to the weights of its ends. From the tip inward, each link takes m from the diagonal
    and h − m from beside it; what is left at its near end belongs to the links before.
    """
    matrix, direction, last = matrix.copy(), _direction(weights), joints[-1]
    pulls = -(weights @ direction)
    own = matrix[last.keypoint, last.keypoint]
    beside = matrix[last.keypoint, last.parent] if last.parent is not None else 0.0
    if not abs(own + beside) > 1e-6 * own:
        raise KeycldError(f"'{names[last.keypoint]}' is balanced about its joint, so that its motion shows no gravity.")
    # A single part is taken as a point mass: one motion does not show more. Where counterweights pull most, gravity
    # points against the sum of all weights.
    gravity = float(pulls[last.keypoint] / (own + beside))
    if gravity < 0:
        gravity, direction, pulls = -gravity, -direction, -pulls
    parts = []
    for joint, length in reversed(list(zip(joints, lengths, strict=True))):
        k, p = joint.keypoint, joint.parent
        own = matrix[k, k]
        if not own > 0:
            raise KeycldError(_RIGID)
        if joint.slide:
            parts.append(_Part(names[k], joint, length, own, 0.0, own * 1e-6))
            continue
        if p is None:
            moment = pulls[k] / gravity if gravity > 1e-9 else 0.0
            mass = (1 + _SPARE) * moment**2 / own if moment else own
        else:
            moment = own + matrix[k, p]
            least = moment**2 / own
            spare = matrix[p, p] + 2 * moment - own - least
            if spare <= 0:
                raise KeycldError(_RIGID)
            mass = least + _SPARE * spare
            matrix[p, p] -= mass - 2 * moment + own
            pulls[p] -= gravity * (mass - moment)
        centre = length * moment / mass
        parts.append(_Part(names[k], joint, length, mass, centre, own * length**2 - mass * centre**2))
    return parts[::-1], gravity * direction


def _check_weights(
    joints: tuple[Joint, ...], parts: list[_Part], weights: Float[np.ndarray, "K 2"], pull: Float[np.ndarray, "2"]
) -> None:
    """Refuse weights that these bodies do not have in this gravity, as far as they act on the motion."""
    explained, slides = np.zeros_like(weights), {}
    for joint, part in zip(joints, parts, strict=True):
        moment = part.mass * part.centre / part.length if part.length else part.mass
        explained[joint.keypoint] -= moment * pull
        if joint.parent is not None:
            explained[joint.parent] -= (part.mass - moment) * pull
        if joint.slide:
            slides[joint.keypoint] = np.array(joint.place)

    def acting(weights: np.ndarray) -> np.ndarray:
        along = {k: (weights[k] @ place) * place for k, place in slides.items()}
        return np.array([along.get(k, row) for k, row in enumerate(weights)])

    stray, total = np.linalg.norm(acting(weights - explained)), np.linalg.norm(acting(weights))
    if stray > _STRAY * total:
        raise KeycldError(
            f"{stray / total:.0%} of the weights are not those of bodies in one gravity, at most {_STRAY:.0%} may be: "
            "measure them on more recordings, or export the keypoints with --to csv."
        )


def _springs(law: ConstrainedLagrangian, parts: list[_Part], unit: float, metres: float) -> None:
    """Put the stiffness of springs on slides."""
    term = terms_of(law).get("springs")
    if not isinstance(term, Springs):
        return
    if len(parts) > 1 or not parts[0].joint.slide:
        raise KeycldError(
            "springs can be exported to MuJoCo for a single part on a line only: export the keypoints with --to csv."
        )
    part = parts[0]
    stiffness = float(np.asarray(term.stiffness)[0, 0])
    along = float(_weights(law)[0] @ np.array(part.joint.place))
    part.stiffness, part.rest = stiffness / unit, -metres * along / stiffness


def _friction(
    law: ConstrainedLagrangian,
    parts: list[_Part],
    joints: tuple[Joint, ...],
    unit: float,
    metres: float,
    elements: _Elements,
) -> None:
    """Put friction on joints, and on tendons where it acts on absolute motion.

    In metres R is metres² times as large, as the energies are. So b of hinges is metres² times as large, and the force
    of dry friction metres times.
    """
    terms = terms_of(law)
    chains = [_chain(joints, k) for k in range(len(joints))]
    viscous = terms.get("viscous")
    if isinstance(viscous, ViscousFriction):
        matrix = np.asarray(viscous.coefficients, float)
        matrix = _along_links((np.tril(matrix) + np.tril(matrix, -1).T) / unit, joints, "friction terms")
        for k in reversed(range(len(joints))):
            _drag(matrix, k, joints, parts, chains[k], elements)
    hinges = terms.get("joints")
    if isinstance(hinges, JointFriction):
        assert isinstance(law.constraint_function, Constraints)
        hinged = hinged_links(law.constraint_function)
        links = [k for k, item in enumerate(law.constraint_function.items) if any(item is link for link in hinged)]
        strengths = np.asarray(hinges.strength, float) / unit * metres**2
        for strength, row in zip(strengths, hinges.hinges, strict=True):
            combined = np.zeros(len(joints))
            for k, share in zip(links, row, strict=True):
                combined[chains[k]] += share
            _turning(parts, elements.tendons, combined, strength)
    dry = terms.get("coulomb")
    if isinstance(dry, CoulombFriction):
        if len(parts) > 1:
            raise KeycldError(
                "dry friction can be exported to MuJoCo for a single part only: export the keypoints with --to csv."
            )
        parts[0].loss = float(np.asarray(dry.strength)[0]) / unit * metres * (parts[0].length or 1.0)
    if any(part.damping < 0 or part.loss < 0 for part in parts):
        raise KeycldError(_GIVES)


def _drag(
    matrix: np.ndarray,
    k: int,
    joints: tuple[Joint, ...],
    parts: list[_Part],
    chain: list[int],
    elements: _Elements,
) -> None:
    """Give the friction of keypoint k to its joint and link, and take it from the matrix; from the tip inward.

    For a link, own |v|² + 2 beside v·v' of its far and near end: where beside is between −own and 0, a friction of the
    turning link and one of its far end; else that of one point on its line, (own v + beside v')² / own.
    """
    joint, part = joints[k], parts[k]
    own = float(matrix[joint.keypoint, joint.keypoint])
    if joint.parent is None:
        # What the links leave of a friction that gives no energy is not negative, but for rounding.
        own = max(own, 0.0) if own > -1e-6 else own
        part.damping += own if joint.slide else own * part.length**2
        return
    beside = float(matrix[joint.keypoint, joint.parent])
    if -own * (1 + 1e-3) <= beside <= 0:
        _turning(parts, elements.tendons, chain, -beside * part.length**2)
        matrix[joint.parent, joint.parent] += beside
        _resisted(part, elements, own + beside, 1.0)
    elif own > 0:
        matrix[joint.parent, joint.parent] -= beside**2 / own
        _resisted(part, elements, (own + beside) ** 2 / own, own / (own + beside))
    else:
        raise KeycldError(_GIVES)


def _chain(joints: tuple[Joint, ...], k: int) -> list[int]:
    """Return the hinges whose angles add up to the direction of link k."""
    found, at = [], joints[k]
    while not at.slide:
        found.append(joints.index(at))
        if at.parent is None:
            break
        at = next(joint for joint in joints if joint.keypoint == at.parent)
    return found[::-1]


def _turning(parts: list[_Part], tendons: ElementTree.Element, chain: list[int] | np.ndarray, damping: float) -> None:
    """Add friction of a sum of joint rates: of one joint on it, of several on a tendon."""
    shares = np.zeros(len(parts))
    if isinstance(chain, list):
        shares[chain] = 1.0
    else:
        shares = chain
    acting = np.flatnonzero(np.abs(shares) > 1e-9)
    if len(acting) == 0 or abs(damping) < 1e-12:
        return
    if len(acting) == 1:
        parts[acting[0]].damping += damping * shares[acting[0]] ** 2
        return
    if damping < 0:
        raise KeycldError(_GIVES)
    tendon = ElementTree.SubElement(tendons, "fixed", damping=_text(damping))
    for k in acting:
        ElementTree.SubElement(tendon, "joint", joint=parts[k].name, coef=_text(shares[k]))


def _resisted(part: _Part, elements: _Elements, damping: float, place: float) -> None:
    """Add dampers from a point on a link's line to points far away, to the right and above: friction in any direction.

    Args:
        part: the link.
        elements: where they go.
        damping: of the point.
        place: of the point, 0 at the near end and 1 at the far end.
    """
    if damping < 1e-9:
        return
    world, tendons, taken = elements
    resisted = _free_name(f"{part.name}_resisted", taken)
    part.resisted = resisted, place * part.length
    for name, (right, above) in (("right", (1.0, 0.0)), ("above", (0.0, 1.0))):
        site = _free_name(f"{part.name}_{name}", taken)
        far = _FAR * part.length * max(1.0, abs(place))
        ElementTree.SubElement(world, "site", name=site, pos=_text(far * right, 0.0, far * above))
        tendon = ElementTree.SubElement(tendons, "spatial", damping=_text(damping))
        ElementTree.SubElement(tendon, "site", site=site)
        ElementTree.SubElement(tendon, "site", site=resisted)


def _free_name(name: str, taken: set[str]) -> str:
    """Return a name with underscores added until no keypoint and no other site has it, and take it."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _body(parent: ElementTree.Element, part: _Part, name: str, place: np.ndarray) -> ElementTree.Element:
    body = ElementTree.SubElement(parent, "body", name=name, pos=_text(place[0], 0.0, place[1]))
    kind = {"type": "slide", "axis": _text(part.joint.place[0], 0.0, part.joint.place[1])}
    if not part.joint.slide:
        kind = {"type": "hinge", "axis": "0 -1 0"}
    forces = {"damping": part.damping, "frictionloss": part.loss, "stiffness": part.stiffness, "springref": part.rest}
    acting = {name: _text(value) for name, value in forces.items() if value}
    ElementTree.SubElement(body, "joint", {"name": part.name} | kind | acting)
    inertia = max(part.inertia, 1e-9 * part.mass)
    ElementTree.SubElement(
        body,
        "inertial",
        pos=_text(0.0, 0.0, -part.centre),
        mass=_text(part.mass),
        diaginertia=_text(inertia, inertia, inertia),
    )
    tip = _text(0.0, 0.0, -part.length)
    ElementTree.SubElement(body, "site", name=part.name, pos=tip)
    if part.resisted is not None:
        resisted, below = part.resisted
        ElementTree.SubElement(body, "site", name=resisted, pos=_text(0.0, 0.0, -below))
    look = {"type": "sphere", "size": "0.05", "contype": "0", "conaffinity": "0", "mass": "0"}
    if part.length:
        look |= {"type": "capsule", "fromto": f"0 0 0 {tip}", "size": _text(0.02 * part.length)}
    ElementTree.SubElement(body, "geom", look)
    return body


def _text(*numbers: float) -> str:
    return " ".join(f"{float(number):.10g}" for number in numbers)
