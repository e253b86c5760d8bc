"""LGN: its presets."""

import dataclasses
from typing import TYPE_CHECKING

from keycld._errors import KeycldError
from keycld.models.latent.config import FastSettings, LatentConfig, PaperSettings
from keycld.models.registry import register_model, register_preset
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from jaxtyping import PRNGKeyArray

    from keycld.models.latent.lgn import LGN

register_model("lgn", family="latent", title="a Lagrangian ½ q̇ᵀM(q)q̇ − V(q) of a latent vector")


@register_preset("released", "lgn")
@dataclasses.dataclass(frozen=True)
class ReleasedLGN(LatentConfig):
    """LGN as the released code of "Which priors matter?" trains it: mid-point rule, one step a frame."""

    mass_offset: float = 1.0
    """λ in the mass matrix M = UᵀU + λI, positive."""
    integrator: str = "rk2"
    """A Runge–Kutta method (`rk2`, `rk4`, …), or `adaptive`: Dormand–Prince with error control."""

    def __post_init__(self) -> None:
        """Refuse masses that could vanish."""
        super().__post_init__()
        if self.mass_offset == 0:
            raise KeycldError("setting mass_offset is above 0: without it the mass matrix may have no inverse.")

    def build(self, scene: Scene, key: "PRNGKeyArray") -> "LGN":
        """Build encoder, masses, potential, an input matrix where there are inputs, and decoder."""
        from keycld.models.latent import lgn

        return lgn.build(self, scene, key)


@register_preset("paper", "lgn")
@dataclasses.dataclass(frozen=True)
class PaperLGN(PaperSettings, ReleasedLGN):
    """The same as the text of the paper has it: learning rate, KL divergence of eq. (3), adaptive integration."""

    integrator: str = "adaptive"
    """A Runge–Kutta method (`rk2`, `rk4`, …), or `adaptive`: Dormand–Prince with error control."""


@register_preset("fast", "lgn")
@dataclasses.dataclass(frozen=True)
class FastLGN(FastSettings, ReleasedLGN):
    """LGN by our recipe, at a third of its rate: at 1.5e-3 roll-outs of eight frames overflow after some 200 steps."""

    rate: float = 5e-4
    """Learning rate of Adam: constant while horizons grow, then annealed along half a cosine."""
