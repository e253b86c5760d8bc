"""The sizes of the data that a model is built for."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Scene:
    """Sizes of the training data; nothing in it comes from test data.

    Attributes:
        height: height of a frame, pixels.
        width: width of a frame, pixels.
        inputs: l, the number of inputs; 0 where nothing drives the motion.
        frames: frames of a training trajectory.
        dt: seconds between frames.
        trajectories: number of training trajectories.
    """

    height: int
    width: int
    inputs: int
    frames: int
    dt: float
    trajectories: int
