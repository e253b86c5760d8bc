"""A pendulum with viscous friction in its hinge."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.systems.registry import register
from keycld.systems.zoo.base import AbstractZooSystem

if TYPE_CHECKING:
    import keycld.mechanics

LENGTH = 0.8


@register
class DampedPendulum(AbstractZooSystem):
    """(m l² + I) θ̈ = m g l sin θ − c θ̇ with a massless rod of l = 0.8 m; E falls by c θ̇² joules a second.

    m = 1 kg, I = 2/5 m r² of a sphere with r = 0.14 m, g = 9.81 m/s², c = 0.1 N m s. State: θ in rad (0 upright,
    positive to the right), θ̇ in rad/s. One keypoint, the bob, at a fixed distance from the pivot, which is 0.15 m right
    of the image centre. Some recordings begin with a turn over the top.
    """

    name = "zoo/damped_pendulum"
    dt = 1 / 40
    state_names, units = ("angle", "angular_velocity"), ("rad", "rad/s")
    keypoints = ("bob",)
    camera_offset, camera_height, camera_distance = -0.15, 0.0, 3.0
    position_ranges, speed_limits, energy_range = ((-np.pi, np.pi),), (6.0,), (-6.0, 5.0)
    mjcf = """
    <mujoco>
      <option><flag contact="disable" energy="enable"/></option>
      <visual><headlight ambient=".4 .4 .4" diffuse=".25 .25 .25"/><map znear=".01"/></visual>
      <statistic extent="3"/>
      <asset>
        <texture name="sky" type="skybox" builtin="flat" rgb1=".5 .7 .6" rgb2=".5 .7 .6" width="32" height="32"/>
        <texture name="wall" type="2d" builtin="checker" rgb1=".45 .65 .55" rgb2=".55 .75 .65" width="64" height="64"/>
        <material name="wall" texture="wall" texrepeat="1 1" texuniform="true"/>
      </asset>
      <worldbody>
        <light pos="-1.5 -3 3" dir=".4 .9 -.8" diffuse=".6 .6 .6"/>
        <camera pos="-.15 -3 0" zaxis="0 -1 0"/>
        <geom type="plane" size="4 4 .25" pos="0 .35 0" zaxis="0 -1 0" material="wall"/>
        <geom type="cylinder" fromto="0 -.06 0 0 .3 0" size=".05" rgba=".2 .2 .2 1"/>
        <body>
          <joint type="hinge" axis="0 1 0" damping=".1"/>
          <geom type="capsule" fromto="0 0 0 0 0 .8" size=".025" mass="0" rgba=".25 .2 .2 1"/>
          <geom name="bob" type="sphere" pos="0 0 .8" size=".14" mass="1" rgba=".75 .1 .35 1"/>
        </body>
      </worldbody>
    </mujoco>
    """

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """The distance from the pivot is constant."""
        from keycld.mechanics import Constraints, DistanceToPoint

        pivot = tuple(self.to_image_plane(np.zeros(2)).tolist())
        return Constraints(keypoints=self.keypoints, items=(DistanceToPoint("bob", pivot),))

    def places(self, q: np.ndarray) -> np.ndarray:
        """Return the centre of the bob."""
        return LENGTH * np.stack([np.sin(q), np.cos(q)], axis=-1)
