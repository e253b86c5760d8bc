"""A pendulum that hangs from a cart between two springs."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.systems.registry import register
from keycld.systems.zoo.base import AbstractZooSystem

if TYPE_CHECKING:
    import keycld.mechanics

LENGTH = 0.55


@register
class SpringCartPendulum(AbstractZooSystem):
    """L = (M + m) ṡ² / 2 + m l ṡ θ̇ cos θ + (m l² + I) θ̇² / 2 − k s² − m g l cos θ, without friction.

    Cart M = 1 kg between two springs of k = 5 N/m each, relaxed in the middle; bob m = 0.3 kg on a massless rod of
    l = 0.55 m, I = 2/5 m ρ² of a sphere with ρ = 0.13 m, g = 9.81 m/s². State: s in m (0 in the middle, positive to the
    right), θ in rad (0 upright, positive to the right), their velocities. Two keypoints: the cart on a horizontal line,
    the bob at a fixed distance from it.
    """

    name = "zoo/spring_cart_pendulum"
    dt = 1 / 40
    state_names, units = ("position", "angle", "velocity", "angular_velocity"), ("m", "rad", "m/s", "rad/s")
    keypoints = ("cart", "bob")
    camera_height, camera_distance = -0.2, 3.2
    position_ranges, speed_limits, energy_range = ((-0.6, 0.6), (0.0, 2 * np.pi)), (1.8, 6.0), (-1.1, 1.6)
    mjcf = """
    <mujoco>
      <option><flag contact="disable" energy="enable"/></option>
      <visual><headlight ambient=".45 .45 .45" diffuse=".45 .45 .45"/><map znear=".01"/></visual>
      <statistic extent="3"/>
      <asset>
        <texture name="sky" type="skybox" builtin="gradient" rgb1=".55 .75 .9" rgb2=".9 .95 1" width="64" height="64"/>
        <texture name="grass" type="2d" builtin="flat" rgb1=".35 .55 .25" rgb2=".35 .55 .25" width="128" height="128"
                 mark="random" markrgb=".3 .45 .2" random=".2"/>
        <material name="grass" texture="grass" texrepeat="1 1" texuniform="true"/>
      </asset>
      <worldbody>
        <light pos="0 -1 4" dir="0 .3 -1" diffuse=".5 .5 .5"/>
        <camera pos="0 -3.2 -.2" zaxis="0 -1 0"/>
        <geom type="plane" size="8 8 .25" pos="0 0 -1.1" material="grass"/>
        <geom type="capsule" fromto="-1.3 .12 0 1.3 .12 0" size=".02" rgba=".3 .3 .3 1"/>
        <site name="left" pos="-1.35 .06 0" size=".01"/>
        <site name="right" pos="1.35 .06 0" size=".01"/>
        <body>
          <joint type="slide" axis="1 0 0"/>
          <geom name="cart" type="box" size=".17 .06 .12" pos="0 .06 0" mass="1" rgba=".45 .2 .6 1"/>
          <site name="middle" pos="0 .06 0" size=".01"/>
          <body>
            <joint type="hinge" axis="0 1 0"/>
            <geom type="capsule" fromto="0 0 0 0 0 .55" size=".025" mass="0" rgba=".2 .2 .2 1"/>
            <geom name="bob" type="sphere" pos="0 0 .55" size=".13" mass=".3" rgba=".9 .15 .15 1"/>
          </body>
        </body>
      </worldbody>
      <tendon>
        <spatial stiffness="5" springlength="1.35" width=".02" rgba=".95 .95 .95 1">
          <site site="left"/><site site="middle"/>
        </spatial>
        <spatial stiffness="5" springlength="1.35" width=".02" rgba=".95 .95 .95 1">
          <site site="middle"/><site site="right"/>
        </spatial>
      </tendon>
    </mujoco>
    """

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """y₁ and |x₁ − x₂| are constant."""
        from keycld.mechanics import Constraints, FixedDistance, OnLine

        items = (OnLine("cart", direction=(1.0, 0.0)), FixedDistance("cart", "bob"))
        return Constraints(keypoints=self.keypoints, items=items)

    def places(self, q: np.ndarray) -> np.ndarray:
        """Return the centre of the cart's front, where the hinge is, and the centre of the bob."""
        cart = np.stack([q[..., 0], np.zeros_like(q[..., 0])], axis=-1)
        rod = LENGTH * np.stack([np.sin(q[..., 1]), np.cos(q[..., 1])], axis=-1)
        return np.stack([cart, cart + rod], axis=-2)
