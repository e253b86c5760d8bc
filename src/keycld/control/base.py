"""What a controller is, and what it needs of a model."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from keycld._errors import KeycldError
from keycld.mechanics import ConstrainedLagrangian, State
from keycld.models.base import AbstractModel


class Belief(eqx.Module):
    """What is believed of one copy of the system.

    Attributes:
        state: positions, velocities, and the constants of the constraints.
        unmodelled: [2K], an acceleration that is seen and that the learned dynamics lack, image-plane units/s².
        sightings: frames in which it was seen.
    """

    state: State
    unmodelled: Float[Array, "dim"]
    sightings: Int[Array, ""]


class AbstractController(eqx.Module):
    """From what is believed of the motion to an input, for **one** copy of the system.

    `begin` and `act` are pure functions of arrays and go into one compiled program with the observer; `attend` may do
    slow work between two frames.
    """

    @abc.abstractmethod
    def begin(self) -> Any:
        """The memory before the first frame: a pytree of arrays, or None."""

    @abc.abstractmethod
    def act(self, belief: Belief, memory: Any) -> tuple[Float[Array, "l"], Any]:
        """The input until the next frame, and the memory after it."""

    def attend(self, beliefs: Belief, memories: Any, held: Float[np.ndarray, "n l"]) -> Any:
        """Look at several copies (leading axis) once their inputs were chosen; the memories, changed where needed."""
        return memories


class Idle(AbstractController):
    """u = 0: what the system does by itself."""

    inputs: int = eqx.field(static=True)

    def begin(self) -> None:
        """Nothing to remember."""

    def act(self, belief: Belief, memory: None) -> tuple[Float[Array, "l"], None]:
        """No input."""
        return jnp.zeros(self.inputs), None


class RandomInput(AbstractController):
    """Inputs uniform in ± a limit, a new one each frame, for comparison.

    Attributes:
        inputs: of all inputs.
        actuators: numbers of those that act.
        limit: the largest |u|.
        seed: every copy draws the same; start them differently.
    """

    inputs: int = eqx.field(static=True)
    actuators: tuple[int, ...] = eqx.field(static=True)
    limit: float
    seed: int = eqx.field(static=True, default=0)

    def begin(self) -> Array:
        """The first key."""
        return jax.random.key_data(jax.random.key(self.seed))

    def act(self, belief: Belief, memory: Array) -> tuple[Float[Array, "l"], Array]:
        """The next number of the sequence."""
        now, later = jax.random.split(jax.random.wrap_key_data(memory))
        u = jax.random.uniform(now, (len(self.actuators),), minval=-self.limit, maxval=self.limit)
        return spread(u, self.actuators, self.inputs), jax.random.key_data(later)


def spread(u: Float[Array, "a"], actuators: tuple[int, ...], inputs: int) -> Float[Array, "l"]:
    """All inputs from those that act; the others are zero."""
    return jnp.zeros(inputs, u.dtype).at[jnp.asarray(actuators)].set(u)


def lagrangian_of(model: AbstractModel) -> ConstrainedLagrangian:
    """The masses, potential energy, input matrix and constraints that a model has learned.

    Raises:
        KeycldError: the model has no potential energy or no input matrix, so nothing can be shaped.
    """
    law = getattr(model, "law", None)
    if not isinstance(law, ConstrainedLagrangian) or law.input_matrix is None:
        raise KeycldError(
            f"control needs a model with a potential energy and an input matrix, and {type(model).__name__} has "
            "learned none: train keycld on data with inputs."
        )
    return law


def actuators_of(names: tuple[str, ...], chosen: tuple[str, ...] | None) -> tuple[int, ...]:
    """The numbers of the inputs that act.

    Args:
        names: of all inputs.
        chosen: of those that act; None for all.

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


def known_inputs(names: tuple[str, ...], moved: list[bool] | None, chosen: tuple[str, ...]) -> tuple[str, ...] | None:
    """The inputs that are to act: those that were chosen, else those whose effect the training could show; None: all.

    Raises:
        KeycldError: an input is to act that never moved in the training data, or there is none that did.
    """
    if moved is None or all(moved):
        return chosen or None
    known = tuple(name for name, did in zip(names, moved, strict=True) if did)
    blind = [name for name in chosen if name in names and name not in known]
    if not known or blind:
        what = f"{blind[0]} never moved" if blind else "no input ever moved"
        raise KeycldError(
            f"{what} in the data that this model was trained on, so it knows nothing of the effect: train on data that "
            "`keycld data make SYSTEM --control full` makes."
        )
    return chosen or known


def check_limit(limit: float | None) -> float:
    """The largest |u| as a number: infinity for None.

    Raises:
        KeycldError: it is not positive.
    """
    value = np.inf if limit is None else float(limit)
    if not value > 0:
        raise KeycldError(f"an input limit is a positive number, or none, not {limit}.")
    return value
