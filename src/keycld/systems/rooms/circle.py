"""A camera on a circle: the set `room/circle`."""

import numpy as np
from jaxtyping import Float

from keycld.systems.registry import register
from keycld.systems.rooms.base import AbstractRoom


@register
class RoomCircle(AbstractRoom):
    """A camera on a parallel of the unit hemisphere: (r cos θ, r sin θ, √(1−r²)), θ growing by 0.1° a frame.

    It looks at the centre of a square room with five still objects: spheres, capsules, cylinders, boxes. Floor, wall
    and objects have random colours, the radius r is uniform in 0 to 0.9, the first angle uniform. State: the camera's
    place and velocity. 256 frames sweep 25.6°, so pictures turn slowly. Source: "Which priors matter?" (arXiv
    2111.05458), section 4.4 and appendix A.1.4. No code or scene was released: the room (3.2 × 3.2 × 1.5), the objects
    (radii 0.08 to 0.16, within 0.65 of the centre), a lamp without shadows and a light at the camera, a field of view
    of 75° and dt = 0.05 are choices of ours.
    """

    name = "room/circle"
    largest_radius = 0.9

    def radius(self, first: float, turned: Float[np.ndarray, "T"]) -> Float[np.ndarray, "T"]:
        """Return the first radius."""
        return np.full_like(turned, first)
