"""A camera on a golden spiral: the set `room/spiral`."""

import numpy as np
from jaxtyping import Float

from keycld.systems.registry import register
from keycld.systems.rooms.base import AbstractRoom

# φ^(1/90°): the radius of a golden spiral grows by this factor a degree.
_GROWTH = 1.0053611


@register
class RoomSpiral(AbstractRoom):
    """A camera on a golden spiral down the unit hemisphere: r = a c^θ, c = 1.0053611 a degree, 0.1° a frame.

    The same rooms as in `room/circle`; the first radius a is uniform in 0 to 0.6 and grows by 14.7 % in 256 frames.
    State: the camera's place and velocity. Source: "Which priors matter?" (arXiv 2111.05458), section 4.4 and
    appendix A.1.4; what these leave open is as in `room/circle`.
    """

    name = "room/spiral"
    largest_radius = 0.6

    def radius(self, first: float, turned: Float[np.ndarray, "T"]) -> Float[np.ndarray, "T"]:
        """Return a radius that grows exponentially."""
        return first * _GROWTH ** np.degrees(turned)
