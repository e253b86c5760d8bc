"""A cart on a rail between two springs, pushed by a motor."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.systems.registry import register
from keycld.systems.zoo.base import AbstractZooSystem

if TYPE_CHECKING:
    import keycld.mechanics


@register
class SpringCart(AbstractZooSystem):
    """m s̈ = −2 k s + 0.5 u with m = 1 kg and two springs of k = 4 N/m, relaxed in the middle: L = m ṡ² / 2 − k s².

    Period 2.22 s, amplitudes 0.25 to 0.6 m, accelerations to ± 6 m/s². State: s in m (0 in the middle, positive to the
    right), ṡ in m/s; input: u in N before the gear of 0.5. One keypoint, the cart, on a horizontal line. Source: a
    harmonic oscillator.
    """

    name = "zoo/spring_cart"
    dt = 1 / 30
    state_names, units = ("position", "velocity"), ("m", "m/s")
    input_names = ("force",)
    keypoints = ("cart",)
    camera_height, camera_distance = 0.25, 3.0
    position_ranges, speed_limits, energy_range = ((-0.6, 0.6),), (1.7,), (0.25, 1.44)
    mjcf = """
    <mujoco>
      <option><flag contact="disable" energy="enable"/></option>
      <visual><headlight ambient=".45 .45 .45" diffuse=".4 .4 .4"/><map znear=".01"/></visual>
      <statistic extent="3"/>
      <asset>
        <texture name="sky" type="skybox" builtin="gradient" rgb1=".75 .85 .95" rgb2=".4 .5 .65" width="64"
                 height="64"/>
        <texture name="tiles" type="2d" builtin="checker" rgb1=".75 .7 .6" rgb2=".6 .55 .45" width="64" height="64"/>
        <material name="tiles" texture="tiles" texrepeat="2 2" texuniform="true"/>
      </asset>
      <worldbody>
        <light pos="-1 -2 4" dir=".25 .5 -1" diffuse=".6 .6 .6"/>
        <camera pos="0 -3 .25" zaxis="0 -1 0"/>
        <geom type="plane" size="6 6 .25" pos="0 0 -.45" material="tiles"/>
        <geom type="box" size="1.2 .1 .03" pos="0 .06 -.19" rgba=".35 .35 .4 1"/>
        <geom type="box" size=".04 .15 .3" pos="-1.16 .06 0" rgba=".35 .35 .4 1"/>
        <geom type="box" size=".04 .15 .3" pos="1.16 .06 0" rgba=".35 .35 .4 1"/>
        <site name="left" pos="-1.15 .06 0" size=".01"/>
        <site name="right" pos="1.15 .06 0" size=".01"/>
        <body>
          <joint name="rail" type="slide" axis="1 0 0"/>
          <geom name="cart" type="box" size=".2 .06 .15" pos="0 .06 0" mass="1" rgba=".85 .15 .1 1"/>
          <site name="middle" pos="0 .06 0" size=".01"/>
        </body>
      </worldbody>
      <tendon>
        <spatial stiffness="4" springlength="1.15" width=".025" rgba=".95 .85 .2 1">
          <site site="left"/><site site="middle"/>
        </spatial>
        <spatial stiffness="4" springlength="1.15" width=".025" rgba=".95 .85 .2 1">
          <site site="middle"/><site site="right"/>
        </spatial>
      </tendon>
      <actuator><motor joint="rail" gear=".5" ctrllimited="true" ctrlrange="-3 3"/></actuator>
    </mujoco>
    """

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """y₁ is constant."""
        from keycld.mechanics import Constraints, OnLine

        return Constraints(keypoints=self.keypoints, items=(OnLine("cart", direction=(1.0, 0.0)),))

    def places(self, q: np.ndarray) -> np.ndarray:
        """Return the centre of the cart's front."""
        return np.stack([q, np.zeros_like(q)], axis=-1)
