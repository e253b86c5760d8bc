"""How good a prediction is: metrics, protocols, trivial baselines, probes of what was learned."""

from typing import TYPE_CHECKING

from keycld._lazy import lazily
from keycld.data.describe.normalised_error import TABLE_UNITS as TABLE_UNITS
from keycld.data.describe.normalised_error import THRESHOLD as DM_THRESHOLD
from keycld.evaluation.summary import setting_text as setting_text
from keycld.evaluation.summary import summary as summary
from keycld.evaluation.summary import threshold_text as threshold_text

if TYPE_CHECKING:
    # Tables and the processes of experiments import what they need of this, without models.
    from keycld.evaluation.ahead import Ahead as Ahead
    from keycld.evaluation.baselines import baseline_predictions as baseline_predictions
    from keycld.evaluation.drift import constraint_drift as constraint_drift
    from keycld.evaluation.drift import energy_drift as energy_drift
    from keycld.evaluation.geometry import difference as difference
    from keycld.evaluation.latent_regression import SyMetric as SyMetric
    from keycld.evaluation.latent_regression import score_symetric as score_symetric
    from keycld.evaluation.latent_regression import symetric as symetric
    from keycld.evaluation.log_physics import IdentifiedLog as IdentifiedLog
    from keycld.evaluation.log_physics import identify_log as identify_log
    from keycld.evaluation.metrics import PixelMoments as PixelMoments
    from keycld.evaluation.metrics import epsilon as epsilon
    from keycld.evaluation.metrics import frame_errors as frame_errors
    from keycld.evaluation.metrics import mean_image as mean_image
    from keycld.evaluation.metrics import relative_errors as relative_errors
    from keycld.evaluation.metrics import statistics as statistics
    from keycld.evaluation.metrics import valid_prediction_time as valid_prediction_time
    from keycld.evaluation.motion import GIVEN as GIVEN
    from keycld.evaluation.motion import MOTION as MOTION
    from keycld.evaluation.motion import evaluate_motion as evaluate_motion
    from keycld.evaluation.motion import fitted_tracks as fitted_tracks
    from keycld.evaluation.named_protocols import PROTOCOLS as PROTOCOLS
    from keycld.evaluation.named_protocols import make_protocol as make_protocol
    from keycld.evaluation.named_protocols import protocol_named as protocol_named
    from keycld.evaluation.named_protocols import protocols_for as protocols_for
    from keycld.evaluation.named_protocols import with_given as with_given
    from keycld.evaluation.observing import observed_states as observed_states
    from keycld.evaluation.observing import observed_tracks as observed_tracks
    from keycld.evaluation.outcome import Evaluation as Evaluation
    from keycld.evaluation.outcome import headline_vpt as headline_vpt
    from keycld.evaluation.outcome import keypoint_names as keypoint_names
    from keycld.evaluation.physics import Measured as Measured
    from keycld.evaluation.physics import constants_of as constants_of
    from keycld.evaluation.physics import measure_physics as measure_physics
    from keycld.evaluation.physics import restless as restless
    from keycld.evaluation.physics import with_fan as with_fan
    from keycld.evaluation.physics_file import PHYSICS as PHYSICS
    from keycld.evaluation.physics_file import Constant as Constant
    from keycld.evaluation.physics_file import Physics as Physics
    from keycld.evaluation.physics_file import Rejected as Rejected
    from keycld.evaluation.physics_file import load_physics as load_physics
    from keycld.evaluation.physics_file import pieces_note as pieces_note
    from keycld.evaluation.physics_file import save_physics as save_physics
    from keycld.evaluation.physics_text import constants_table as constants_table
    from keycld.evaluation.physics_text import physics_table as physics_table
    from keycld.evaluation.physics_text import value_text as value_text
    from keycld.evaluation.predicting import Predicted as Predicted
    from keycld.evaluation.predicting import predict as predict
    from keycld.evaluation.predicting import predict_batch as predict_batch
    from keycld.evaluation.prediction_file import predict_file as predict_file
    from keycld.evaluation.probe import Probe as Probe
    from keycld.evaluation.probe import fit_probe as fit_probe
    from keycld.evaluation.probe import invert_landmarks as invert_landmarks
    from keycld.evaluation.protocols import METRICS as METRICS
    from keycld.evaluation.protocols import Protocol as Protocol
    from keycld.evaluation.published import PAPER_VPT as PAPER_VPT
    from keycld.evaluation.published import published_vpt as published_vpt
    from keycld.evaluation.reference_images import References as References
    from keycld.evaluation.reference_images import references as references
    from keycld.evaluation.reference_images import validation_epsilon as validation_epsilon
    from keycld.evaluation.scoring import evaluate as evaluate
    from keycld.evaluation.storage import as_json as as_json
    from keycld.evaluation.storage import load_evaluation as load_evaluation
    from keycld.evaluation.storage import save_evaluation as save_evaluation
    from keycld.evaluation.sweeps import evaluate_sweeps as evaluate_sweeps
    from keycld.evaluation.track_physics import measure_tracks as measure_tracks

__getattr__ = lazily(__name__)

__all__ = [
    "Ahead",
    "Constant",
    "DM_THRESHOLD",
    "Evaluation",
    "GIVEN",
    "IdentifiedLog",
    "METRICS",
    "MOTION",
    "Measured",
    "PAPER_VPT",
    "PHYSICS",
    "PROTOCOLS",
    "Physics",
    "PixelMoments",
    "Predicted",
    "Probe",
    "Protocol",
    "References",
    "Rejected",
    "SyMetric",
    "TABLE_UNITS",
    "as_json",
    "baseline_predictions",
    "constants_of",
    "constants_table",
    "constraint_drift",
    "difference",
    "energy_drift",
    "epsilon",
    "evaluate",
    "evaluate_motion",
    "evaluate_sweeps",
    "fit_probe",
    "frame_errors",
    "headline_vpt",
    "identify_log",
    "invert_landmarks",
    "keypoint_names",
    "load_evaluation",
    "load_physics",
    "make_protocol",
    "mean_image",
    "measure_physics",
    "measure_tracks",
    "observed_states",
    "observed_tracks",
    "physics_table",
    "pieces_note",
    "predict",
    "predict_batch",
    "predict_file",
    "protocol_named",
    "protocols_for",
    "published_vpt",
    "references",
    "relative_errors",
    "restless",
    "save_evaluation",
    "save_physics",
    "score_symetric",
    "setting_text",
    "statistics",
    "summary",
    "symetric",
    "threshold_text",
    "fitted_tracks",
    "valid_prediction_time",
    "validation_epsilon",
    "value_text",
    "with_fan",
    "with_given",
]
