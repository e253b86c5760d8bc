"""The settings that all presets of the KeyCLD family share: keypoints and constraints."""

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import tyro

from keycld._errors import KeycldError
from keycld.models.config import ModelConfig

if TYPE_CHECKING:
    from keycld.mechanics import Constraints

MODELS = ("keycld", "keycld-nc", "node2", "fc")
MOST_ORDERED = 6
"""All orders of so many keypoints are compared: 720."""
_EXAMPLE = 'keypoints = ["point"]\n\n[[constraint]]\nkind = "distance_to_point"\nkeypoint = "point"\npoint = [0, 0]\n'


@dataclasses.dataclass(frozen=True)
class KeyCLDConfig(ModelConfig):
    """KeyCLD, KeyCLD-NC, NODE2 or FC: one config class for the four models of the family; `model` names which."""

    # Names of schema 1.
    RENAMED: ClassVar[dict[str, str]] = {
        "start.": "initial_state.",
        "beginning.sighting": "velocity_prior.observation",
        "beginning.": "velocity_prior.",
    }
    ADDED: ClassVar[Mapping[str, float]] = {
        "initial_state.error": 0.003,
        "dynamics.law.potential.terms.pairs.offset": 0.0,
    }
    HALF: ClassVar[tuple[str, ...]] = ("estimator.", "renderer.")

    constraints: Annotated[Any, tyro.conf.Suppress] = None
    """Keypoints and constraints as TOML text, or in Python a `Constraints`; by default those of the data set."""

    @property
    def phi(self) -> "Constraints":
        """The constraint function Φ with the names of its keypoints.

        Raises:
            KeycldError: the config is not completed yet, or the text is wrong.
        """
        if self.constraints is None:
            raise KeycldError(
                "KeyCLD needs keypoints and constraints: put a constraints.toml next to the data, or give one with "
                "--constraints FILE.toml (docs/constraints.md shows one)."
            )
        from keycld.mechanics import Constraints, parse_constraints

        if isinstance(self.constraints, str):
            return parse_constraints(self.constraints, "the constraints")
        if not isinstance(self.constraints, Constraints):
            raise KeycldError(f"setting constraints is TOML text or a Constraints, not {self.constraints!r}.")
        return self.constraints

    @property
    def keypoints(self) -> int:
        """K."""
        return len(self.phi.keypoints)

    def completed(self, source: Any = None) -> "ModelConfig":
        """Return the config with its constraints, as text where they are relations, otherwise in Python.

        Args:
            source: the data set or system whose constraints are taken where the config has none.

        Raises:
            KeycldError: neither the config nor the source has constraints, or they read parameters of a state.
        """
        from keycld.mechanics import AbstractRelation, Constraints, dump_constraints

        found = self.constraints
        if found is None:
            found = _EXAMPLE if source is None else source.constraints
        elif callable(found) and not isinstance(found, Constraints):
            found = Constraints(_keypoints(source), (found,))
        if isinstance(found, Constraints) and all(isinstance(item, AbstractRelation) for item in found.items):
            found = dump_constraints(found) if found.squared else found
        completed = dataclasses.replace(self, constraints=found)
        phi = completed.phi  # raises now if the text is wrong
        if self.model in ("keycld", "fc"):
            _check_parameters(phi)
        return completed

    def refusal(self, source: Any) -> str | None:
        """Return that there are no keypoints, where neither the config nor the source has any."""
        return "no keypoints" if self.constraints is None and source.constraints is None else None

    def settings(self) -> dict[str, Any]:
        """Return all fields as JSON values; constraints with a Python function among them become None."""
        text = self.constraints if isinstance(self.constraints, str) else None
        return super(KeyCLDConfig, dataclasses.replace(self, constraints=text)).settings()


def _check_parameters(phi: "Constraints") -> None:
    """Refuse a Φ that reads parameters of the state: in trained models none have names of a user's own."""
    import jax

    try:
        jax.eval_shape(phi, jax.ShapeDtypeStruct((phi.dimension,), "float32"))
    except KeyError as error:
        raise KeycldError(
            f"the constraints read the parameter {error} of the state, but models that are trained know none by names "
            "of your own: write its value into the constraints."
        ) from error


def _keypoints(source: Any) -> tuple[str, ...]:
    if source is None or source.constraints is None:
        raise KeycldError("a plain function names no keypoints: wrap it as Constraints(('a', 'b'), (function,)).")
    return source.constraints.keypoints
