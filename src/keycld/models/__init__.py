"""Models: each a small composition of vision and mechanics behind one interface."""

from keycld.models.base import AbstractModel as AbstractModel
from keycld.models.base import Prediction as Prediction
from keycld.models.beginning import Beginning as Beginning
from keycld.models.keycld import KeyCLD as KeyCLD
from keycld.models.losses import AbstractLoss as AbstractLoss
from keycld.models.losses import CollocationLoss as CollocationLoss
from keycld.models.losses import PredictionLoss as PredictionLoss
from keycld.models.losses import TrackLoss as TrackLoss
from keycld.models.losses import VisionLoss as VisionLoss
from keycld.models.short_rollout_loss import ShortRolloutLoss as ShortRolloutLoss
from keycld.models.starts import AbstractStart as AbstractStart
from keycld.models.starts import CentralStart as CentralStart
from keycld.models.starts import DifferenceStart as DifferenceStart
from keycld.models.starts import FittedStart as FittedStart
from keycld.models.starts import shared_constants as shared_constants

__all__ = [
    "AbstractLoss",
    "AbstractModel",
    "AbstractStart",
    "Beginning",
    "CentralStart",
    "CollocationLoss",
    "DifferenceStart",
    "FittedStart",
    "KeyCLD",
    "Prediction",
    "PredictionLoss",
    "ShortRolloutLoss",
    "TrackLoss",
    "VisionLoss",
    "shared_constants",
]
