"""RGN: a network maps the latent vector of one frame to that of the next."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics import AbstractField, AbstractIntegrator, Scalar
from keycld.models.latent.unstructured import AbstractUnstructuredModel, parts
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
