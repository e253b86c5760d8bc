"""Control laws by name: every module in `laws/` that registers one is known."""

import abc
import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, TypeVar

from jaxtyping import Array, Float

from keycld._entry_points import import_modules, load_entry_points
from keycld._errors import KeycldError, unknown
from keycld.control.base import AbstractController
from keycld.mechanics import ConstrainedLagrangian


class Problem(NamedTuple):
    """What a controller is made for.

    Attributes:
        law: learned law of motion: masses, potential energy, input matrix, constraints.
        goal: x* [2K], image-plane units.
        actuators: positions of the inputs that act, among the model's; the others stay zero.
        limit: the largest |u|; infinity for none. The agent clips the input to it.
        dt: seconds between frames.
        seed: of anything random.
    """

    law: ConstrainedLagrangian
    goal: Float[Array, "dim"]
    actuators: tuple[int, ...]
    limit: float
    dt: float
    seed: int


class Trust(NamedTuple):
    """How far a state estimator trusts the learned dynamics and the observed keypoints; see `PredictCorrect`.

    Attributes:
        acceleration_error: σₐ, image-plane units/s².
        observation_error: σ_y, image-plane units.
        adaptation: ρ, 1/s.
    """

    acceleration_error: float = 10.0
    observation_error: float = 0.005
    adaptation: float = 6.0


@dataclasses.dataclass(frozen=True)
class AbstractControlLaw(abc.ABC):
    """A control law: its fields are its settings, and it makes the controller of a problem.

    A subclass sets `name`; the first line of its docstring is its title in `keycld control --help`.

    Attributes:
        name: by which it is known.
        trust: what suits the state estimator under this law.
    """

    name: ClassVar[str]
    trust: ClassVar[Trust] = Trust()

    @abc.abstractmethod
    def controller(self, problem: Problem) -> AbstractController:
        """Return the controller that solves a problem.

        Raises:
            KeycldError: the law cannot solve it.
        """


_LAWS: dict[str, type[AbstractControlLaw]] = {}
L = TypeVar("L", bound=type[AbstractControlLaw])


def register_law(law: L) -> L:
    """Make a control law known by its `name`; a class decorator.

    A file in `keycld/control/laws/`, or in a package with an entry point of the group `keycld.laws`, with one decorated
    class is all that a new law needs.
    """
    _LAWS[law.name] = law
    return law


def control_laws() -> dict[str, type[AbstractControlLaw]]:
    """Return all registered control laws by name."""
    import_modules("keycld.control.laws")
    load_entry_points("keycld.laws", "control law")
    return dict(_LAWS)


def law_named(name: str, settings: Mapping[str, Any] | None = None) -> AbstractControlLaw:
    """Return a control law with some settings changed from their defaults.

    Args:
        name: of a registered law.
        settings: values by field name.

    Raises:
        KeycldError: an unknown name of a law or of a setting, or a value that the law refuses.
    """
    laws = control_laws()
    if name not in laws:
        raise unknown("control law", name, laws)
    defaults = {field.name: field.default for field in dataclasses.fields(laws[name])}
    values = dict(settings or {})
    for key, value in values.items():
        if not defaults:
            raise KeycldError(f"the control law '{name}' has no settings: leave out {key}.")
        if key not in defaults:
            raise unknown("setting", key, defaults, of=f"the control law '{name}'")
        if isinstance(defaults[key], float):
            if not isinstance(value, int | float):
                raise KeycldError(f"setting {key} of the control law '{name}' is a number, not '{value}'.")
            values[key] = float(value)
    return laws[name](**values)


def check_positive(**values: float) -> None:
    """Refuse settings that are not positive.

    Raises:
        KeycldError: names the first one.
    """
    for name, value in values.items():
        if not value > 0:
            raise KeycldError(f"setting {name} is a positive number, not {value}.")
