"""Neural ODE: the latent vector moves along a learned field."""

from typing import TYPE_CHECKING

from jaxtyping import PRNGKeyArray

from keycld.models.base import Reversible
from keycld.models.latent.integrators import latent_integrator
from keycld.models.latent.unstructured import AbstractUnstructuredModel, parts
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from keycld.models.latent.recipes.ode import ReleasedODE


class ODE(AbstractUnstructuredModel, Reversible):
    """Neural ODE of "Which priors matter?": ṡ = F(s, u) by one network, continuous in time and without energies.

    ODE[TR] is the same model, trained in the regime `forward_backward`.
    """


def build(config: "ReleasedODE", scene: Scene, key: PRNGKeyArray) -> ODE:
    """Build an ODE with random weights."""
    return ODE(**parts(config, scene, latent_integrator(config.integrator), key))
