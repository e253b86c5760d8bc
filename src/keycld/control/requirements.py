"""What control needs: capabilities of the model, names of inputs, a limit."""

from collections.abc import Sequence
from typing import TypeVar

import equinox as eqx
import numpy as np

from keycld._errors import KeycldError
from keycld.models.base import AbstractModel, HasKeypoints, HasLagrangian
from keycld.systems import AbstractSystem

C = TypeVar("C", bound=eqx.Module)
_NEEDS = {HasLagrangian: "a learned Lagrangian", HasKeypoints: "keypoints"}


def require(model: AbstractModel, capability: type[C]) -> C:
    """Return the model as one that has a capability.

    Args:
        model: any model.
        capability: `HasLagrangian` or `HasKeypoints`.

    Raises:
        KeycldError: it lacks the capability.
    """
    if not isinstance(model, capability):
        raise KeycldError(
            f"control needs a model with {_NEEDS[capability]}, and {type(model).__name__} has none: train the model "
            "keycld on data with inputs."
        )
    return model


def plant_inputs(lagrangian: HasLagrangian, names: Sequence[str], system: AbstractSystem) -> tuple[int, ...]:
    """Return the positions of the model's inputs among those of the system.

    Args:
        lagrangian: the model.
        names: of the inputs in its training data, in their order.
        system: to be controlled.

    Raises:
        KeycldError: the model has no input, or another number than there are names; or the system lacks one of them.
    """
    inputs = lagrangian.law.inputs
    if not inputs:
        raise KeycldError(
            "this model was trained on data without inputs, so it knows the effect of none: train on data that "
            f"`keycld data make {system.name} --control full` makes."
        )
    if inputs != len(names):
        raise KeycldError(
            f"the model takes {inputs} input(s), but {len(names)} are named ({', '.join(names)}): name those of its "
            "training data, in their order."
        )
    positions_of(system.input_names, names)
    return tuple(system.input_names.index(name) for name in names)


def positions_of(names: Sequence[str], chosen: Sequence[str] | None) -> tuple[int, ...]:
    """Return the positions of chosen inputs in a list of names, in ascending order.

    Args:
        names: of all inputs.
        chosen: of some of them; None for all.

    Raises:
        KeycldError: an unknown name, or none.
    """
    if chosen is None:
        return tuple(range(len(names)))
    unknown_names = [name for name in chosen if name not in names]
    if unknown_names or not chosen:
        wrong = f"no input '{unknown_names[0]}'" if unknown_names else "no input at all was chosen"
        raise KeycldError(f"{wrong}: choose from {', '.join(names)}.")
    return tuple(sorted(names.index(name) for name in set(chosen)))


def check_limit(limit: float | None) -> float:
    """Return the largest |u| as a number: infinity for None.

    Raises:
        KeycldError: it is not positive.
    """
    value = np.inf if limit is None else float(limit)
    if not value > 0:
        raise KeycldError(f"an input limit is a positive number, or none, not {limit}.")
    return value


def check_finite_limit(limit: float, what: str) -> None:
    """Refuse a law without an input limit that needs one.

    Raises:
        KeycldError: the limit is infinite.
    """
    if not np.isfinite(limit):
        raise KeycldError(f"{what} an input limit: give one, such as --limit 3.")
