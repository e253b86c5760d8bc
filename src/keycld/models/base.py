"""The contract that every model fulfils, and the capabilities that some have: any model runs on any data set."""

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics import AbstractDynamics, ConstrainedLagrangian, State, own_law
from keycld.vision import Observation


class Prediction(NamedTuple):
    """Frames 0 … T−1 of a trajectory and the states that they were rendered from, stacked along time."""

    frames: Float[Array, "T H W 3"]
    states: State


class Gaussian(NamedTuple):
    """A normal distribution of independent numbers.

    Attributes:
        mean: μ.
        deviation: σ, positive.
    """

    mean: Float[Array, "D"]
    deviation: Float[Array, "D"]


class AbstractModel(eqx.Module):
    """Images → state → later states → images, for **one** trajectory; `jax.vmap` makes batches.

    A model with more capabilities also inherits from some of the interfaces below.
    """

    @property
    @abstractmethod
    def context(self) -> int:
        """The smallest number of consecutive frames that `infer` needs."""

    @abstractmethod
    def anchor(self, n: int) -> int:
        """Return the index of the frame that the state inferred from `n` frames belongs to."""

    @abstractmethod
    def infer(self, frames: Float[Array, "n H W 3"], dt: Float[Array, ""], u: Float[Array, "..."]) -> State:
        """Estimate the state at frame `anchor(n)` from `n` consecutive frames and the inputs between them.

        Args:
            frames: consecutive frames in [0, 1], n ≥ `context`.
            dt: seconds between frames.
            u: constant `[l]`, or `[≥ n − 1, l]` from the first of these frames on.
        """

    @abstractmethod
    def rollout(self, state: State, dt: Float[Array, ""], u: Float[Array, "..."], steps: int) -> State:
        """Return the given state and the `steps` states that follow it, stacked.

        Args:
            state: the first state.
            dt: seconds between states. Only a `Reversible` model accepts a negative one: then the motion runs
                backward, and the inputs, which stay in the order of time, are read in reverse.
            u: `[l]`, constant, or `[steps, l]`.
            steps: number of states to add.
        """

    @abstractmethod
    def render(self, state: State) -> Float[Array, "H W 3"]:
        """Render the frame of a state."""

    def predict(
        self,
        frames: Float[Array, "n H W 3"],
        dt: Float[Array, ""],
        u: Float[Array, "..."],
        length: int,
        first: int = 0,
    ) -> Prediction:
        """Predict frames 0 … `length` − 1 of a trajectory from some of its frames and its inputs alone.

        The state inferred at the anchor is rolled out to the end, and back to frame 0. A model that is not `Reversible`
        cannot predict frames before its anchor: there the given frames are returned, and the anchor's state is
        repeated.

        Args:
            frames: n ≥ `context` consecutive frames, the trajectory's frames `first` … `first` + n − 1.
            dt: seconds between frames.
            u: `[l]`, constant, or `[length, l]`, of which `u[k]` is held from frame k to k + 1.
            length: how many frames to return.
            first: number of the first given frame. Above 0 the model must be `Reversible`.

        Raises:
            KeycldError: too few frames; a given frame with a value that is not finite (outside of `jit`, where values
                can be read); `first` > 0 for a model that cannot run backward.
        """
        if frames.ndim != 4 or frames.shape[0] < self.context:
            raise KeycldError(
                f"a prediction needs {self.context} given frames or more, [n, H, W, 3], not {list(frames.shape)}."
            )
        if not isinstance(frames, Tracer):
            # In NumPy, which can read the values of concrete arrays inside of `jit` too.
            bad = np.flatnonzero(~np.isfinite(np.asarray(frames)).all(axis=(1, 2, 3)))
            if bad.size:
                raise KeycldError(f"given frame {bad[0]} holds NaN or infinity; give finite values in [0, 1].")
        if first > 0 and not isinstance(self, Reversible):
            raise KeycldError(
                f"{type(self).__name__} cannot run backward, so it predicts nothing before frame {first}: give the "
                "first frames."
            )
        anchor = self.anchor(frames.shape[0])
        state = self.infer(frames, dt, u if u.ndim == 1 else u[first:])
        states = self.unroll(state, first + anchor, dt, u, length)
        pictures = jax.vmap(self.render)(states)
        if not isinstance(self, Reversible):
            pictures = jnp.concatenate([frames[:anchor].astype(pictures.dtype), pictures[anchor:]])
        return Prediction(pictures, states)

    def unroll(self, state: State, anchor: int, dt: Float[Array, ""], u: Float[Array, "..."], length: int) -> State:
        """Return the states of frames 0 … `length` − 1, stacked, from the one at frame `anchor`.

        Args:
            state: at frame `anchor`.
            anchor: its frame; from 0 to `length` − 1.
            dt: seconds between frames, positive.
            u: `[l]`, constant, or `[≥ length − 1, l]` from frame 0 on.
            length: how many states to return.
        """
        constant = u.ndim == 1
        states = self.rollout(state, dt, u if constant else u[anchor : length - 1], length - 1 - anchor)
        if anchor == 0:
            return states
        if isinstance(self, Reversible):
            back = self.rollout(state, -dt, u if constant else u[:anchor], anchor)
            earlier = jax.tree.map(lambda past: past[:0:-1], back)
        else:
            earlier = jax.tree.map(lambda here: jnp.broadcast_to(here[None], (anchor, *here.shape)), state)
        return jax.tree.map(lambda past, future: jnp.concatenate([past, future]), earlier, states)


class Reversible(eqx.Module):
    """A model whose `rollout` accepts a negative `dt`."""


class HasKeypoints(eqx.Module):
    """A model whose state holds named points in the image."""

    @abstractmethod
    def observe(self, frame: Float[Array, "H W 3"]) -> Observation:
        """Estimate the keypoints of one frame."""

    @abstractmethod
    def keypoints(self, state: State) -> Float[Array, "K 2"]:
        """Return the keypoints of a state in image-plane units."""

    @abstractmethod
    def at_rest(self, keypoints: Float[Array, "K 2"]) -> State:
        """Return the state with these keypoints and zero velocity; its constants are Φ of these keypoints."""


class HasEnergies(eqx.Module):
    """A model with kinetic and potential energy, known up to one common factor and a constant."""

    @abstractmethod
    def kinetic_energy(self, state: State) -> Float[Array, ""]:
        """Return T."""

    @abstractmethod
    def potential_energy(self, state: State) -> Float[Array, ""]:
        """Return V."""


class HasPosterior(eqx.Module):
    """A model that infers a normal distribution of a latent vector."""

    @abstractmethod
    def posterior(self, frames: Float[Array, "n H W 3"]) -> Gaussian:
        """Return the distribution of the latent vector given the first `context` frames."""


class HasConstraints(eqx.Module):
    """A model whose motion keeps its constraint functions Φ constant."""

    @abstractmethod
    def constraint_deviation(self, state: State) -> Float[Array, "n"]:
        """Return Φ(x) minus the constants of the state, in the constraints' units; n may be 0."""


class HasInputMatrix(eqx.Module):
    """A model on which inputs act as forces g(x) u."""

    @abstractmethod
    def input_matrix(self, state: State) -> Float[Array, "dim l"]:
        """Return g; l may be 0."""


class HasLagrangian(HasEnergies, HasConstraints, HasInputMatrix):
    """A model whose dynamics are a constrained Lagrangian in Cartesian coordinates, eq. (6); controllers use it.

    Attributes:
        dynamics: the law with its integrator, one step for each frame.
    """

    dynamics: eqx.AbstractVar[AbstractDynamics]

    @property
    @abstractmethod
    def law(self) -> ConstrainedLagrangian:
        """M, V, g, Φ and dissipation."""

    @property
    @abstractmethod
    def constants(self) -> Float[Array, " n"] | None:
        """Values of Φ that all trajectories share, `[n]`; None where each trajectory has its own."""

    def kinetic_energy(self, state: State) -> Float[Array, ""]:
        """Return T = ½ vᵀMv."""
        return own_law(self.law, state.parameters).kinetic_energy(*state.coordinates)

    def potential_energy(self, state: State) -> Float[Array, ""]:
        """Return V(x)."""
        return own_law(self.law, state.parameters).potential_energy(state.coordinates.x)

    def constraint_deviation(self, state: State) -> Float[Array, "n"]:
        """Return Φ(x) − constants."""
        law = own_law(self.law, state.parameters)
        return law.constraint(state.coordinates.x, state.parameters) - state.parameters["constants"]

    def input_matrix(self, state: State) -> Float[Array, "dim l"]:
        """Return g(x)."""
        x, matrix = state.coordinates.x, own_law(self.law, state.parameters).input_matrix
        return jnp.zeros((x.shape[0], 0)) if matrix is None else matrix(x)


CAPABILITIES = {
    "reversible": Reversible,
    "keypoints": HasKeypoints,
    "energies": HasEnergies,
    "constraints": HasConstraints,
    "input matrix": HasInputMatrix,
    "lagrangian": HasLagrangian,
}
"""Interfaces by the name that `keycld models` prints."""


def capabilities(model: AbstractModel) -> tuple[str, ...]:
    """Return the names of all interfaces that a model offers."""
    return tuple(name for name, kind in CAPABILITIES.items() if isinstance(model, kind))
