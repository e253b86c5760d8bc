"""HGN: its presets."""

import dataclasses
from typing import TYPE_CHECKING

from keycld.models.latent.config import FastSettings, LatentConfig, PaperSettings
from keycld.models.registry import register_model, register_preset
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from jaxtyping import PRNGKeyArray

    from keycld.models.latent.hgn import HGN

register_model("hgn", family="latent", title="a Hamiltonian T(p) + V(q) of a latent vector, HGN++")


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
class PaperHGN(PaperSettings, ReleasedHGN):
    """The same as the text of the paper has it: another learning rate, and the KL divergence of eq. (3)."""


@register_preset("fast", "hgn")
@dataclasses.dataclass(frozen=True)
class FastHGN(FastSettings, ReleasedHGN):
    """HGN++ by our recipe: a quarter of an hour on one core."""


@register_preset("original", "hgn")
@dataclasses.dataclass(frozen=True)
class OriginalHGN(ReleasedHGN):
    """The HGN of 2019, in the configuration that the benchmark compares HGN++ with.

    Convolutions all through: q and p are maps of 4×4 cells. It sees 31 frames and reconstructs the same ones.
    """

    given: int = 31
    """Consecutive frames that the encoder sees, stacked as channels; a prediction starts from as many."""
    regime: str = "given"
    """Direction of training, as in the other presets; `given` rolls the motion back over the given frames."""
    objective: str = "geco"
    """What is minimised. `elbo`: −log-likelihood plus `beta` times the KL divergence. `geco`: the KL divergence, with
    the mean squared error held at `kappa`."""

    def build(self, scene: Scene, key: "PRNGKeyArray") -> "HGN":
        """Build encoder, transform, two energies, an input matrix where there are inputs, and decoder."""
        from keycld.models.latent import hgn

        return hgn.build_original(self, scene, key)
