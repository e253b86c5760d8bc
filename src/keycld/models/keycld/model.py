"""KeyCLD: keypoints are the Cartesian state of a constrained Lagrangian. Its ablations leave out one part each."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.mechanics import (
    AbstractLaw,
    AbstractMechanicalDynamics,
    ConstrainedLagrangian,
    MechanicalDynamics,
    Motion,
    SecondOrderNetwork,
    State,
    rough_places,
)
from keycld.models.base import AbstractModel, HasKeypoints, HasLagrangian, Reversible
from keycld.models.checks import check_inputs, check_size
from keycld.models.keycld.exchange import arranged, fitting_order, orders
from keycld.models.keycld.initial_state import AbstractInitialState
from keycld.models.keycld.own_initial_state import OwnInitialState
from keycld.models.keycld.part_light import PartLight
from keycld.models.keycld.velocity_prior import VelocityPrior
from keycld.vision import AbstractEstimator, AbstractRenderer, Observation


class AbstractKeypointModel(AbstractModel, HasKeypoints, Reversible):
    """Keypoint estimator, dynamics of keypoints, renderer (arXiv v1, sections 2 and 3).

    The state holds positions and velocities of the keypoints in image-plane units, and what is constant along this
    trajectory: the values of Φ and, where recordings differ in them, the looks of the parts and the law's own
    parameters (`own_parameters`).

    Attributes:
        estimator: frame → keypoints, eq. (8).
        dynamics: the law of motion of the keypoints and its integrator.
        renderer: keypoints → frame, eq. (9).
        initial_state: keypoints of the given frames → state.
        velocity_prior: the prior of the initial velocity; None: the velocity is that of the given frames.
        part_light: the light of the parts, which tells own parameters and where discs are; None: there are neither.
        exchange: parts exchange their looks from recording to recording, and the constraints tell which keypoint is
            which part (`exchange`).
    """

    estimator: AbstractEstimator
    dynamics: AbstractMechanicalDynamics
    renderer: AbstractRenderer
    initial_state: AbstractInitialState
    velocity_prior: eqx.AbstractVar[VelocityPrior | None]
    part_light: eqx.AbstractVar[PartLight | None]
    exchange: eqx.AbstractVar[bool]

    @property
    def context(self) -> int:
        """The number of frames that the initial state needs."""
        return self.initial_state.given

    @property
    def moving_law(self) -> AbstractLaw:
        """The law of motion: accelerations, and for KeyCLD energies."""
        return self.dynamics.law

    @property
    def inputs(self) -> int:
        """The number of inputs of the law of motion."""
        law = self.moving_law
        assert isinstance(law, (ConstrainedLagrangian, SecondOrderNetwork))
        return law.inputs

    def anchor(self, n: int) -> int:
        """Return the frame that the initial state belongs to."""
        return self.initial_state.anchor

    def constraint(self, x: Float[Array, " dim"]) -> Float[Array, " n"]:
        """Return Φ(x); empty for a law without constraints."""
        law = self.moving_law
        return law.constraint(x) if isinstance(law, ConstrainedLagrangian) else x[:0]

    def located(self, x: Float[Array, "M dim"]) -> "AbstractKeypointModel":
        """Return the model with unknown pivots and directions of its constraints fitted to M observed positions."""
        law = self.moving_law
        if not isinstance(law, ConstrainedLagrangian) or not law.constraint_function.unknowns:
            return self
        return eqx.tree_at(
            lambda model: model.dynamics.law.constraint_function, self, law.constraint_function.located(x)
        )

    def observe(self, frame: Float[Array, "H W 3"]) -> Observation:
        """Estimate the keypoints of one frame, and its heat maps if the estimator has any.

        Raises:
            KeycldError: the frame does not have the size of the rendered frames.
        """
        if not self.exchange and self.part_light is None:
            check_size(frame, self.renderer.size)
            return self.estimator(frame)
        return jax.tree.map(lambda part: part[0], self.observe_clips(frame[None, None]))

    def observe_clips(self, frames: Float[Array, "B F H W 3"]) -> Observation:
        """Estimate the keypoints of F frames of each of B recordings; the arrays have an axis of all B·F in front.

        Where parts exchange their looks, the frames of a recording tell together which keypoint is which part.

        Raises:
            KeycldError: the frames do not have the size of the rendered frames.
        """
        check_size(frames[0, 0], self.renderer.size)
        each = frames.reshape(-1, *frames.shape[2:])
        observed = jax.vmap(self.estimator)(each)
        if self.part_light is not None:
            x = observed.keypoints.reshape(*frames.shape[:2], -1, 2)
            light = self.part_light
            moved = jax.lax.map(lambda recording: light.moved(*recording), (frames, x))
            observed = observed._replace(keypoints=moved.reshape(observed.keypoints.shape))
        if not self.exchange:
            return observed
        x = jax.lax.stop_gradient(observed.keypoints).reshape(*frames.shape[:2], -1, 2)
        law, own = self.moving_law, isinstance(self.initial_state, OwnInitialState)
        assert isinstance(law, ConstrainedLagrangian)
        place = (lambda flat: rough_places(law, flat[None])[0]) if own else None
        order, _ = jax.vmap(lambda x: fitting_order(self.constraint, self.initial_state.shared, x, place))(x)
        return arranged(observed, order.repeat(frames.shape[1], axis=0))

    def keypoints(self, state: State) -> Float[Array, "K 2"]:
        """Return the positions in the state."""
        return state.coordinates.x.reshape(-1, 2)

    def at_rest(self, keypoints: Float[Array, "K 2"]) -> State:
        """Return the state with these keypoints and zero velocity; looks of zero where recordings differ in them."""
        x = keypoints.reshape(-1)
        blank = jax.eval_shape(self.observe, jax.ShapeDtypeStruct((*self.renderer.size, 3), x.dtype)).looks
        looks = {} if blank is None else {"looks": jnp.zeros(blank.shape)}
        return State(Motion(x, jnp.zeros_like(x)), {"constants": self.constraint(x), **looks})

    def render(self, state: State) -> Float[Array, "H W 3"]:
        """Render the keypoints of the state."""
        return self.renderer(self.keypoints(state), state.parameters.get("looks"))

    def infer(self, frames: Float[Array, "n H W 3"], dt: Float[Array, ""], u: Float[Array, "..."]) -> State:
        """Estimate the state from the keypoints of the given frames, as many as the initial state can use.

        Looks are the means over the given frames. Where parts exchange their looks and recordings have own parameters,
        few frames do not tell by Φ which keypoint is which part: the state of the likeliest order counts.

        Raises:
            KeycldError: the frames or the inputs do not have the sizes of the training data.
        """
        observed = self.observe_clips(frames[None])
        light = None if self.part_light is None else self.part_light(frames, observed.keypoints)
        if self.exchange and isinstance(self.initial_state, OwnInitialState):
            check_inputs(u, self.inputs)
            search, choices = self.initial_state.searched, orders(observed.keypoints.shape[1])
            states, costs = jax.lax.map(
                lambda order: search(
                    self.dynamics,
                    observed.keypoints[:, order].reshape(len(frames), -1),
                    dt,
                    u,
                    None if light is None else light[order],
                ),
                choices,
            )
            best = jnp.argmin(costs)
            state = jax.tree.map(lambda part: part[best], states)
            observed = arranged(observed, jnp.broadcast_to(choices[best][None], (len(frames), len(choices[best]))))
        else:
            state = self.state_of(observed.keypoints, dt, u, light)
        if observed.looks is None:
            return state
        return State(state.coordinates, {**state.parameters, "looks": jnp.mean(observed.looks, axis=0)})

    def state_of(
        self,
        keypoints: Float[Array, "n K 2"],
        dt: Float[Array, ""],
        u: Float[Array, "..."],
        light: Float[Array, "K 4"] | None = None,
    ) -> State:
        """Estimate the state from keypoints that were observed in consecutive frames; light tells own parameters.

        Raises:
            KeycldError: the inputs do not have the sizes of the training data.
        """
        check_inputs(u, self.inputs)
        x = keypoints.reshape(len(keypoints), -1)
        state, covariance = self.initial_state.smooth(self.dynamics, x, dt, u, light)
        if self.velocity_prior is None:
            return state
        assert isinstance(self.dynamics, MechanicalDynamics)
        return self.velocity_prior(self.dynamics, state, u if u.ndim == 1 else u[0], covariance)

    def rollout(self, state: State, dt: Float[Array, ""], u: Float[Array, "..."], steps: int) -> State:
        """Integrate the dynamics; the constants of the constraints stay those of the given state."""
        motion = self.dynamics.rollout(state, u, dt, steps)
        parameters = jax.tree.map(lambda p: jnp.broadcast_to(p, (steps + 1, *p.shape)), state.parameters)
        return State(motion, parameters)


class KeyCLD(AbstractKeypointModel, HasLagrangian):
    """Keypoints whose dynamics are a constrained Lagrangian (M, V, g, Φ), eq. (6).

    M, V and g are known up to one common factor. The paper's ablations replace parts: KeyCLD-NC has a law without
    constraints, FC a `DenseEstimator` and a `DenseRenderer`. NODE2 is a class of its own, because it has no energies.
    """

    velocity_prior: VelocityPrior | None = None
    part_light: PartLight | None = None
    exchange: bool = eqx.field(static=True, default=False)

    @property
    def law(self) -> ConstrainedLagrangian:
        """Masses, potential energy, input matrix and constraints."""
        assert isinstance(self.dynamics.law, ConstrainedLagrangian)
        return self.dynamics.law

    @property
    def constants(self) -> Float[Array, " n"] | None:
        """Values of Φ that training measured over all frames; None where each trajectory has its own."""
        return self.initial_state.shared


class NODE2(AbstractKeypointModel):
    """Keypoints whose dynamics are a second-order neural differential equation: no energies, no constraints."""

    velocity_prior: None = None
    part_light: None = None
    exchange: bool = eqx.field(static=True, default=False)
