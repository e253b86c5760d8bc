"""Models that predict the next picture from all earlier ones with recurrent networks. Importable without JAX.

Settings in `config`, module in `model`, cells in `cells`, loss in `losses`, presets in `recipes`.
"""

from keycld.models.recurrent.config import RecurrentConfig as RecurrentConfig
from keycld.models.registry import find_presets

find_presets(f"{__name__}.recipes")

__all__ = ["RecurrentConfig"]
