"""Models: each a small composition of vision and mechanics behind one interface."""

from keycld.models.base import AbstractModel as AbstractModel
from keycld.models.base import Prediction as Prediction
from keycld.models.keycld import KeyCLD as KeyCLD
from keycld.models.losses import AbstractLoss as AbstractLoss
from keycld.models.losses import CollocationLoss as CollocationLoss
from keycld.models.losses import PredictionLoss as PredictionLoss
from keycld.models.losses import TrackLoss as TrackLoss
from keycld.models.losses import VisionLoss as VisionLoss

__all__ = [
    "AbstractLoss",
    "AbstractModel",
    "CollocationLoss",
    "KeyCLD",
    "Prediction",
    "PredictionLoss",
    "TrackLoss",
    "VisionLoss",
]
