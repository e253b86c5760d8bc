"""A bob that hangs on a spring and moves up and down."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.systems.registry import register
from keycld.systems.zoo.base import AbstractZooSystem

if TYPE_CHECKING:
    import keycld.mechanics


@register
class SpringBob(AbstractZooSystem):
    """m z̈ = −m g − k z with m = 0.8 kg, k = 20 N/m, g = 9.81 m/s²: L = m ż² / 2 − m g z − k z² / 2.

    Period 1.26 s; it rests at z = −0.392 m; amplitudes 0.15 to 0.49 m. State: z in m (0 where the spring of 0.7 m is
    relaxed, positive upward), ż in m/s. One keypoint, the bob, on a vertical line, in the left half of the picture.
    Source: a harmonic oscillator with gravity.
    """

    name = "zoo/spring_bob"
    dt = 1 / 30
    state_names, units = ("height", "velocity"), ("m", "m/s")
    keypoints = ("bob",)
    camera_offset, camera_height, camera_distance = 0.35, -0.25, 3.0
    position_ranges, speed_limits, energy_range = ((-0.9, 0.1),), (2.5,), (-1.3, 0.9)
    mjcf = """
    <mujoco>
      <option><flag contact="disable" energy="enable"/></option>
      <visual><headlight ambient=".35 .35 .35" diffuse=".25 .25 .25"/><map znear=".01"/></visual>
      <statistic extent="3"/>
      <asset>
        <texture name="sky" type="skybox" builtin="flat" rgb1=".9 .9 .85" rgb2=".9 .9 .85" width="32" height="32"/>
        <texture name="wall" type="2d" builtin="gradient" rgb1=".95 .9 .75" rgb2=".7 .75 .6" width="64" height="64"/>
        <material name="wall" texture="wall"/>
      </asset>
      <worldbody>
        <light pos="-1 -2.5 2" dir=".5 1 -.6" diffuse=".4 .4 .4"/>
        <camera pos=".35 -3 -.25" zaxis="0 -1 0"/>
        <geom type="plane" size="2.5 2.5 .25" pos=".35 .45 -.25" zaxis="0 -1 0" material="wall"/>
        <geom type="box" size=".3 .1 .05" pos="0 0 .75" rgba=".4 .25 .15 1"/>
        <site name="top" pos="0 0 .7" size=".01"/>
        <body>
          <joint type="slide" axis="0 0 1"/>
          <geom name="bob" type="sphere" size=".16" mass=".8" rgba=".1 .25 .75 1"/>
          <site name="bob" size=".01"/>
        </body>
      </worldbody>
      <tendon>
        <spatial stiffness="20" springlength=".7" width=".015" rgba=".3 .3 .3 1">
          <site site="top"/><site site="bob"/>
        </spatial>
      </tendon>
    </mujoco>
    """

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """x₁ is constant."""
        from keycld.mechanics import Constraints, OnLine

        return Constraints(keypoints=self.keypoints, items=(OnLine("bob", direction=(0.0, 1.0)),))

    def places(self, q: np.ndarray) -> np.ndarray:
        """Return the centre of the bob."""
        return np.stack([np.zeros_like(q), q], axis=-1)
