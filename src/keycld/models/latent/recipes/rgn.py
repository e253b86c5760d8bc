"""RGN and RGN-Res: their presets."""

import dataclasses
from typing import TYPE_CHECKING, ClassVar

from keycld.models.latent.config import FastSettings, LatentConfig, PaperSettings
from keycld.models.registry import register_model, register_preset
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from jaxtyping import PRNGKeyArray

    from keycld.models.latent.rgn import RGN

register_model("rgn", family="latent", title="a network from one frame's latent vector to the next one's")
register_model("rgn-res", family="latent", title="the same, added to the latent vector (RGN Res)")


@register_preset("released", "rgn", "rgn-res")
@dataclasses.dataclass(frozen=True)
class ReleasedRGN(LatentConfig):
    """RGN and RGN-Res as the released code of "Which priors matter?" trains them."""

    REVERSIBLE: ClassVar[bool] = False

    def build(self, scene: Scene, key: "PRNGKeyArray") -> "RGN":
        """Build encoder, map and decoder."""
        from keycld.models.latent import rgn

        return rgn.build(self, scene, key)


@register_preset("paper", "rgn", "rgn-res")
@dataclasses.dataclass(frozen=True)
class PaperRGN(PaperSettings, ReleasedRGN):
    """The same as the text of the paper has it: another learning rate, and the KL divergence of eq. (3)."""


@register_preset("fast", "rgn-res")
@dataclasses.dataclass(frozen=True)
class FastRGNRes(FastSettings, ReleasedRGN):
    """RGN-Res by our recipe."""


@register_preset("fast", "rgn")
@dataclasses.dataclass(frozen=True)
class FastRGN(FastSettings, ReleasedRGN):
    """RGN by our recipe: its map begins as the identity, with a third of the rate and longer first stages."""

    rate: float = 5e-4
    """Learning rate of Adam: constant while horizons grow, then annealed along half a cosine."""
    shares: tuple[float, ...] = (0.2, 0.2)
    """Shares of the steps that the first stages take; the last stage takes the rest."""

    def build(self, scene: Scene, key: "PRNGKeyArray") -> "RGN":
        """Build encoder, map and decoder."""
        from keycld.models.latent import rgn

        return rgn.build_still(self, scene, key)
