"""Models that move a latent vector: encoder and decoder of images in common, dynamics of their own.

Importable without JAX. Shared: settings in `config`, the chassis in `model`, losses in `losses`. A model is a module,
such as `hgn`, and a file in `recipes` that registers it with its presets.
"""

from keycld.models.latent.config import LatentConfig as LatentConfig
from keycld.models.registry import find_presets

find_presets(f"{__name__}.recipes")

__all__ = ["LatentConfig"]
