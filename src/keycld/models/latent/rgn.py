"""RGN: a network maps the latent vector of one frame to that of the next."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics import AbstractField, AbstractIntegrator, FirstOrderDynamics, Scalar, begin_as_identity
from keycld.models.latent.unstructured import AbstractUnstructuredModel, NetworkField, parts
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from keycld.models.latent.recipes.rgn import ReleasedRGN


class Jump(AbstractIntegrator):
    """A map instead of an equation: s' = F(s, u), or s' = s + F(s, u). The time of a step does not count.

    Attributes:
        residual: whether F is what a step adds.
        substeps: applications of the map a frame.
    """

    residual: bool = eqx.field(static=True)
    substeps: int = eqx.field(static=True, default=1)

    def initial_memory(self, field: AbstractField, coordinates: Any, parameters: Any, h: Scalar) -> None:
        """Return None: there is nothing to remember."""

    def advance(
        self,
        field: AbstractField,
        coordinates: Float[Array, "D"],
        memory: None,
        parameters: dict[str, Any],
        u: Float[Array, "l"],
        h: Scalar,
    ) -> tuple[Float[Array, "D"], None]:
        """Apply the map; h is not used."""
        found = field.derivative(coordinates, u, parameters)
        return coordinates + found if self.residual else found, None


class RGN(AbstractUnstructuredModel):
    """Recurrent Generative Network of "Which priors matter?": one network, applied once a frame, forward only."""


def build(config: "ReleasedRGN", scene: Scene, key: PRNGKeyArray) -> RGN:
    """Build an RGN with random weights."""
    return RGN(**parts(config, scene, Jump(residual=config.model == "rgn-res"), key))


def build_still(config: "ReleasedRGN", scene: Scene, key: PRNGKeyArray) -> RGN:
    """Build an RGN whose map is the identity before training: nothing moves, as in RGN-Res, and nothing is lost.

    Usual random weights shrink the latent vector at each frame. After a few frames nothing is left of it, and training
    ends at the mean picture.
    """
    model = build(config, scene, key)
    assert isinstance(model.dynamics, FirstOrderDynamics) and isinstance(model.dynamics.field, NetworkField)
    still = begin_as_identity(model.dynamics.field.network, key=jax.random.fold_in(key, 1))
    return eqx.tree_at(lambda m: m.dynamics.field.network, model, still)
