"""The physical constants of a clip from the middles of its parts, told apart by colour: without a network."""

import numpy as np

from keycld.evaluation.physics import Measured, measure_physics
from keycld.mechanics import Candidate, Scale
from keycld.models.keycld.discover import observed_pieces
from keycld.models.keycld.identify import identify
from keycld.models.keycld.selection import Tried


def measure_tracks(
    candidate: Candidate, dt: float, *, tried: Tried | None, pixel: float, scale: Scale | None = None
) -> Measured | None:
    """Measure the constants of a mechanism on the tracks in which it was found.

    Fitted are the pieces that show all parts whole, with the forces that the motion asks for. A track is the middle of
    what is seen of a part, so a part that is often half covered is measured less well than a keypoint of a trained
    model.

    Args:
        candidate: a mechanism whose constraints hold.
        dt: seconds between frames.
        tried: which forces are tried; None: all.
        pixel: size of a pixel, image-plane units.
        scale: a known length or g, for constants in metres.

    Returns:
        None where no piece is long enough.

    Raises:
        KeycldError: as `measure_physics`.
    """
    observed = observed_pieces(candidate, len(candidate.x), dt)
    if observed is None:
        return None
    found = identify(observed.dynamics, observed.tracks, pixel=pixel, tried=tried)
    return measure_physics(
        found.dynamics,
        np.asarray(observed.tracks.x),
        np.asarray(observed.tracks.u),
        dt,
        mechanism=candidate.mechanism,
        scale=scale,
        tried=tried,
        pixel=pixel,
    )
