"""KeyCLD and its ablations: keypoints are the Cartesian state of a constrained Lagrangian. Importable without JAX.

The config is in `config`, the module in `model`, the losses in `losses` and `short_rollout_loss`; `recipes` has one
file for each preset.
"""

from keycld.models.keycld.config import KeyCLDConfig as KeyCLDConfig
from keycld.models.registry import find_presets, register_model

_TITLES = {
    "keycld": "keypoints as the state of a constrained Lagrangian",
    "keycld-nc": "the same without the constraint function",
    "node2": "a second-order neural ODE on keypoints instead of the Lagrangian",
    "fc": "KeyCLD with fully connected networks instead of heat maps",
}

for _name, _title in _TITLES.items():
    register_model(_name, family="keycld", title=_title)
find_presets(f"{__name__}.recipes")

__all__ = ["KeyCLDConfig"]
