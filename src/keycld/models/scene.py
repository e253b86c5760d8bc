"""What a model must know of the data that it is built for."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Scene:
    """Sizes of the training data; never anything measured on test data.

    Attributes:
        height: of the pictures, pixels.
        width: likewise.
        inputs: l, the number of inputs; 0 where nothing drives the motion.
        frames: of a training trajectory.
        dt: seconds between frames.
        trajectories: how many there are.
    """

    height: int
    width: int
    inputs: int
    frames: int
    dt: float
    trajectories: int
