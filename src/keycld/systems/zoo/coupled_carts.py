"""Two carts on a rail, coupled to each other and to the walls by springs."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.systems.registry import register
from keycld.systems.zoo.base import AbstractZooSystem

if TYPE_CHECKING:
    import keycld.mechanics

REST = np.array([-0.4, 0.4])


@register
class CoupledCarts(AbstractZooSystem):
    """m₁ s̈₁ = −k₁ s₁ + k₂ (s₂ − s₁), m₂ s̈₂ = −k₁ s₂ − k₂ (s₂ − s₁): L = T − (k₁ s₁² + k₂ (s₂ − s₁)² + k₁ s₂²) / 2.

    m₁ = 1 kg, m₂ = 0.7 kg, k₁ = 12 N/m to the walls, k₂ = 8 N/m between the carts; no friction. State: displacements
    s₁ and s₂ in m from their places of rest, 0.4 m left and right of the middle, positive to the right; their
    velocities. Two keypoints, the carts, on horizontal lines. Source: two coupled harmonic oscillators.
    """

    name = "zoo/coupled_carts"
    dt = 1 / 30
    state_names = ("left", "right", "left_velocity", "right_velocity")
    units = ("m", "m", "m/s", "m/s")
    keypoints = ("left", "right")
    camera_height, camera_distance = -0.2, 3.2
    # At the largest energy the carts come 0.42 m close, and each moves 0.35 m from its place.
    position_ranges, speed_limits, energy_range = ((-0.35, 0.35), (-0.35, 0.35)), (1.4, 1.6), (0.3, 1.0)
    mjcf = """
    <mujoco>
      <option><flag contact="disable" energy="enable"/></option>
      <visual><headlight ambient=".5 .5 .5" diffuse=".3 .3 .3"/><map znear=".01"/></visual>
      <statistic extent="3"/>
      <asset>
        <texture name="sky" type="skybox" builtin="flat" rgb1=".12 .14 .2" rgb2=".12 .14 .2" width="32" height="32"/>
        <texture name="wall" type="2d" builtin="checker" rgb1=".16 .2 .3" rgb2=".2 .25 .36" width="64" height="64"/>
        <material name="wall" texture="wall" texrepeat="3 3" texuniform="true"/>
      </asset>
      <worldbody>
        <light pos="1 -3 3" dir="-.2 .8 -.8" diffuse=".7 .7 .7"/>
        <camera pos="0 -3.2 -.2" zaxis="0 -1 0"/>
        <geom type="plane" size="6 6 .25" pos="0 .5 0" zaxis="0 -1 0" material="wall"/>
        <geom type="capsule" fromto="-1.3 .06 -.15 1.3 .06 -.15" size=".02" rgba=".7 .7 .7 1"/>
        <geom type="box" size=".05 .15 .2" pos="-1.27 .06 0" rgba=".7 .7 .7 1"/>
        <geom type="box" size=".05 .15 .2" pos="1.27 .06 0" rgba=".7 .7 .7 1"/>
        <site name="west" pos="-1.22 .06 0" size=".01"/>
        <site name="east" pos="1.22 .06 0" size=".01"/>
        <body pos="-.4 0 0">
          <joint type="slide" axis="1 0 0"/>
          <geom name="left" type="box" size=".14 .06 .14" pos="0 .06 0" mass="1" rgba=".95 .75 .1 1"/>
          <site name="left" pos="0 .06 0" size=".01"/>
        </body>
        <body pos=".4 0 0">
          <joint type="slide" axis="1 0 0"/>
          <geom name="right" type="box" size=".12 .06 .12" pos="0 .06 0" mass=".7" rgba=".15 .8 .35 1"/>
          <site name="right" pos="0 .06 0" size=".01"/>
        </body>
      </worldbody>
      <tendon>
        <spatial stiffness="12" springlength=".82" width=".018" rgba=".9 .9 .9 1">
          <site site="west"/><site site="left"/>
        </spatial>
        <spatial stiffness="8" springlength=".8" width=".012" rgba=".9 .9 .9 1">
          <site site="left"/><site site="right"/>
        </spatial>
        <spatial stiffness="12" springlength=".82" width=".018" rgba=".9 .9 .9 1">
          <site site="right"/><site site="east"/>
        </spatial>
      </tendon>
    </mujoco>
    """

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """y₁ and y₂ are constant."""
        from keycld.mechanics import Constraints, OnLine

        items = tuple(OnLine(cart, direction=(1.0, 0.0)) for cart in self.keypoints)
        return Constraints(keypoints=self.keypoints, items=items)

    def places(self, q: np.ndarray) -> np.ndarray:
        """Return the centres of the carts' fronts."""
        return np.stack([REST + q, np.zeros_like(q)], axis=-1)
