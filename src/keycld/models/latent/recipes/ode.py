"""Neural ODE and ODE[TR]: their presets."""

import dataclasses
from typing import TYPE_CHECKING

from keycld.models.latent.config import FastSettings, LatentConfig, PaperSettings
from keycld.models.registry import register_model, register_preset
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from jaxtyping import PRNGKeyArray

    from keycld.models.latent.ode import ODE

register_model("ode", family="latent", title="a neural ordinary differential equation of a latent vector")
register_model("ode-tr", family="latent", title="the same trained forward and backward in time, ODE[TR]")


@register_preset("released", "ode")
@dataclasses.dataclass(frozen=True)
class ReleasedODE(LatentConfig):
    """ODE as the released code of "Which priors matter?" runs it: Dormand–Prince with error control.

    Its sweep also names `rk2`, under a key that the code does not read.
    """

    integrator: str = "adaptive"
    """A Runge–Kutta method (`rk2`, `rk4`, …), or `adaptive`: Dormand–Prince with error control."""

    def build(self, scene: Scene, key: "PRNGKeyArray") -> "ODE":
        """Build encoder, field and decoder."""
        from keycld.models.latent import ode

        return ode.build(self, scene, key)


@dataclasses.dataclass(frozen=True)
class TimeReversal:
    """What makes ODE[TR] of ODE. Without a base class: it must not bring back the defaults of other settings."""

    regime: str = "forward_backward"
    """Direction of training, as in the other models; `forward_backward` is the name TR."""


@register_preset("released", "ode-tr")
@dataclasses.dataclass(frozen=True)
class ReleasedODETR(TimeReversal, ReleasedODE):
    """ODE[TR] as the released code of "Which priors matter?" runs it."""


@register_preset("paper", "ode")
@dataclasses.dataclass(frozen=True)
class PaperODE(PaperSettings, ReleasedODE):
    """The same as the text of the paper has it: another learning rate, and the KL divergence of eq. (3)."""


@register_preset("paper", "ode-tr")
@dataclasses.dataclass(frozen=True)
class PaperODETR(TimeReversal, PaperODE):
    """ODE[TR] as the text of the paper has it."""


@register_preset("fast", "ode")
@dataclasses.dataclass(frozen=True)
class FastODE(FastSettings, ReleasedODE):
    """ODE by our recipe, with the mid-point rule."""

    integrator: str = "rk2"
    """A Runge–Kutta method (`rk2`, `rk4`, …), or `adaptive`: Dormand–Prince with error control."""


@register_preset("fast", "ode-tr")
@dataclasses.dataclass(frozen=True)
class FastODETR(TimeReversal, FastODE):
    """ODE[TR] by our recipe, with the mid-point rule."""
