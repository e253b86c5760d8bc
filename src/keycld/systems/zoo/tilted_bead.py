"""A bead on a tilted rail, held by a spring and slowed by viscous and by dry friction."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.systems.registry import register
from keycld.systems.zoo.base import AbstractZooSystem

if TYPE_CHECKING:
    import keycld.mechanics

TILT = np.radians(20.0)
DOWNHILL = np.array([np.cos(TILT), -np.sin(TILT)])
DRY, SOFTNESS = 0.06, 0.05


@register
class TiltedBead(AbstractZooSystem):
    """m s̈ = m g sin α − k s − c ṡ − f tanh(ṡ / w): Coulomb friction f, softened below w.

    m = 0.5 kg, g = 9.81 m/s², α = 20° downward to the right, k = 6 N/m, c = 0.08 N s/m, f = 0.06 N (coefficient 0.013),
    w = 0.05 m/s. V = k s² / 2 − m g sin α s; E falls by c ṡ² + f ṡ tanh(ṡ / w) watts. It comes to rest near s = 0.28 m.
    State: s in m (0 where the spring is relaxed, positive downhill), ṡ in m/s. One keypoint, the bead, on a tilted
    line.
    """

    name = "zoo/tilted_bead"
    dt = 1 / 30
    state_names, units = ("position", "velocity"), ("m", "m/s")
    keypoints = ("bead",)
    camera_offset, camera_height, camera_distance = 0.1, -0.15, 2.8
    position_ranges, speed_limits, energy_range = ((-0.36, 0.92),), (2.2,), (0.1, 1.0)
    mjcf = """
    <mujoco>
      <option><flag contact="disable" energy="enable"/></option>
      <visual><headlight ambient=".4 .4 .4" diffuse=".25 .25 .25"/><map znear=".01"/></visual>
      <statistic extent="3"/>
      <asset>
        <texture name="sky" type="skybox" builtin="flat" rgb1=".8 .65 .7" rgb2=".8 .65 .7" width="32" height="32"/>
        <texture name="wall" type="2d" builtin="checker" rgb1=".85 .7 .72" rgb2=".75 .58 .64" width="64" height="64"/>
        <material name="wall" texture="wall" texrepeat="2 2" texuniform="true"/>
      </asset>
      <worldbody>
        <light pos=".5 -2.5 3" dir="-.1 .8 -1" diffuse=".6 .6 .6"/>
        <camera pos=".1 -2.8 -.15" zaxis="0 -1 0"/>
        <geom type="plane" size="5 5 .25" pos="0 .3 0" zaxis="0 -1 0" material="wall"/>
        <body euler="0 20 0">
          <geom type="box" size="1.05 .08 .025" pos=".15 .08 -.19" mass="0" rgba=".3 .25 .3 1"/>
          <geom type="box" size=".03 .08 .2" pos="-.82 .08 -.02" mass="0" rgba=".3 .25 .3 1"/>
          <site name="post" pos="-.8 0 0" size=".01"/>
          <body>
            <joint type="slide" axis="1 0 0" damping=".08"/>
            <geom name="bead" type="sphere" size=".16" mass=".5" rgba=".05 .5 .5 1"/>
            <site name="bead" size=".01"/>
          </body>
        </body>
      </worldbody>
      <tendon>
        <spatial stiffness="6" springlength=".8" width=".015" rgba=".3 .25 .3 1">
          <site site="post"/><site site="bead"/>
        </spatial>
      </tendon>
    </mujoco>
    """

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """The component across the rail is constant."""
        from keycld.mechanics import Constraints, OnLine

        return Constraints(keypoints=self.keypoints, items=(OnLine("bead", tuple(DOWNHILL.tolist())),))

    def places(self, q: np.ndarray) -> np.ndarray:
        """Return the centre of the bead."""
        return q[..., None] * DOWNHILL

    def force(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the dry friction."""
        return -DRY * np.tanh(v / SOFTNESS)
