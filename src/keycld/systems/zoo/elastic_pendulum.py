"""A bob on a spring that turns around a pivot."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.systems.registry import register
from keycld.systems.zoo.base import AbstractZooSystem

if TYPE_CHECKING:
    import keycld.mechanics


@register
class ElasticPendulum(AbstractZooSystem):
    """m r̈ = −k (|r| − l) r / |r| − m g e_z with r = (x, z) from the pivot: L = m |ṙ|² / 2 − k (|r| − l)² / 2 − m g z.

    m = 0.8 kg, k = 25 N/m, l = 0.6 m, g = 9.81 m/s²; no friction. It rests 0.914 m below the pivot. State: x and z in m
    (to the right and upward of the pivot), their velocities. One keypoint, the bob, free in the plane: no constraint.
    Chaotic at high energy. Source: the swinging spring of Vitt and Gorelik (1933).
    """

    name = "zoo/elastic_pendulum"
    dt = 1 / 30
    state_names, units = ("x", "z", "x_velocity", "z_velocity"), ("m", "m", "m/s", "m/s")
    keypoints = ("bob",)
    camera_height, camera_distance = -0.5, 3.6
    position_ranges, speed_limits, energy_range = ((-0.9, 0.9), (-1.3, -0.3)), (2.0, 2.0), (-5.2, -2.6)
    mjcf = """
    <mujoco>
      <option><flag contact="disable" energy="enable"/></option>
      <visual><headlight ambient=".5 .5 .5" diffuse=".5 .5 .5"/><map znear=".01"/></visual>
      <statistic extent="3"/>
      <asset>
        <texture name="sky" type="skybox" builtin="gradient" rgb1=".1 .05 .2" rgb2=".5 .25 .45" width="64" height="64"/>
        <texture name="floor" type="2d" builtin="checker" rgb1=".2 .1 .25" rgb2=".3 .15 .35" width="64" height="64"/>
        <material name="floor" texture="floor" texrepeat="1 1" texuniform="true"/>
      </asset>
      <worldbody>
        <light pos="0 0 4" diffuse=".5 .5 .5"/>
        <camera pos="0 -3.6 -.5" zaxis="0 -1 0"/>
        <geom type="plane" size="8 8 .25" pos="0 0 -1.75" material="floor"/>
        <geom type="cylinder" fromto="0 -.05 0 0 .05 0" size=".06" rgba=".8 .8 .8 1"/>
        <site name="pivot" size=".01"/>
        <body>
          <joint type="slide" axis="1 0 0"/>
          <joint type="slide" axis="0 0 1"/>
          <geom name="bob" type="sphere" size=".15" mass=".8" rgba="1 .75 .15 1"/>
          <site name="bob" size=".01"/>
        </body>
      </worldbody>
      <tendon>
        <spatial stiffness="25" springlength=".6" width=".015" rgba=".9 .9 .9 1">
          <site site="pivot"/><site site="bob"/>
        </spatial>
      </tendon>
    </mujoco>
    """

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """None: the bob is free in the plane."""
        from keycld.mechanics import Constraints

        return Constraints(keypoints=self.keypoints)

    def places(self, q: np.ndarray) -> np.ndarray:
        """Return the centre of the bob."""
        return q[..., None, :]
