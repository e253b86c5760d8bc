"""HGN: its presets."""

import dataclasses
from typing import TYPE_CHECKING

from keycld.models.latent.config import LatentConfig
from keycld.models.registry import register_model, register_preset
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from jaxtyping import PRNGKeyArray

    from keycld.models.latent.hgn import HGN

register_model("hgn", family="latent", title="a Hamiltonian T(p) + V(q) of a latent vector (HGN++ of the second paper)")


@register_preset("released", "hgn")
@dataclasses.dataclass(frozen=True)
class ReleasedHGN(LatentConfig):
    """HGN++ as the released code of "Which priors matter?" trains it, the column HGN of its tables.

    128 windows of 64 frames a step; 500,000 steps need a GPU.
    """

    def build(self, scene: Scene, key: "PRNGKeyArray") -> "HGN":
        """Build encoder, two energies, an input matrix where there are inputs, and decoder."""
        from keycld.models.latent import hgn

        return hgn.build(self, scene, key)


@register_preset("paper", "hgn")
@dataclasses.dataclass(frozen=True)
class PaperHGN(ReleasedHGN):
    """The same as the text of the paper has it: another learning rate, and the KL divergence of eq. (3)."""

    rate: float = 5e-4
    """Learning rate of Adam."""
    kl_against: str = "frame"
    """Next to which likelihood `beta` weighs the KL divergence. `window`: that of all frames, as in the released code.
    `frame`: that of one frame, the mean over the window, as in eq. (3)."""
