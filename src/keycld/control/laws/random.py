"""Random inputs, for comparison."""

from dataclasses import dataclass
from typing import ClassVar

import equinox as eqx
import jax
from jaxtyping import Array, Float

from keycld.control.base import AbstractController, Belief, spread
from keycld.control.registry import AbstractControlLaw, Problem, register_law
from keycld.control.requirements import check_finite_limit


class RandomInput(AbstractController):
    """Gives inputs uniform in ± a limit, a new one each frame.

    Attributes:
        inputs: l, how many there are.
        actuators: positions of those that act.
        limit: the largest |u|.
        seed: every copy samples the same sequence; give them different initial states.
    """

    inputs: int = eqx.field(static=True)
    actuators: tuple[int, ...] = eqx.field(static=True)
    limit: float
    seed: int = eqx.field(static=True, default=0)

    def initial_memory(self) -> Array:
        """Return the first key."""
        return jax.random.key_data(jax.random.key(self.seed))

    def act(self, belief: Belief, memory: Array) -> tuple[Float[Array, "l"], Array]:
        """Return the next input of the sequence, and the next key."""
        now, later = jax.random.split(jax.random.wrap_key_data(memory))
        u = jax.random.uniform(now, (len(self.actuators),), minval=-self.limit, maxval=self.limit)
        return spread(u, self.actuators, self.inputs), jax.random.key_data(later)


@register_law
@dataclass(frozen=True)
class RandomLaw(AbstractControlLaw):
    """Uniform random inputs in ± the limit; for comparison. Needs --limit."""

    name: ClassVar[str] = "random"

    def controller(self, problem: Problem) -> RandomInput:
        """Return random inputs from the problem's seed.

        Raises:
            KeycldError: there is no limit.
        """
        check_finite_limit(problem.limit, "random inputs need")
        return RandomInput(problem.law.inputs, problem.actuators, problem.limit, problem.seed)
