"""A triple pendulum without friction."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.systems.registry import register
from keycld.systems.zoo.base import AbstractZooSystem

if TYPE_CHECKING:
    import keycld.mechanics

LENGTH = 0.42


@register
class TriplePendulum(AbstractZooSystem):
    """Three bobs on massless rods in a chain: L = Σ (m |ṙᵢ|² + I φ̇ᵢ²) / 2 − m g zᵢ.

    Absolute angles φᵢ = θ₁ + … + θᵢ, rᵢ = rᵢ₋₁ + l (sin φᵢ, cos φᵢ), r₀ = 0. m = 0.5 kg, l = 0.42 m, I = 2/5 m ρ² of
    spheres with ρ = 0.13 m, g = 9.81 m/s². State: θ₁ in rad (0 upright, positive to the right), θ₂ and θ₃ relative to
    the rods before, their velocities. Three keypoints, the bobs: fixed distances pivot–first, first–second,
    second–third. Chaotic.
    """

    name = "zoo/triple_pendulum"
    dt = 1 / 60
    state_names = ("first", "second", "third", "first_velocity", "second_velocity", "third_velocity")
    units = ("rad", "rad", "rad", "rad/s", "rad/s", "rad/s")
    keypoints = ("first", "second", "third")
    camera_height, camera_distance = -0.1, 3.6
    substeps = 10
    position_ranges = ((0.0, 2 * np.pi), (-np.pi, np.pi), (-np.pi, np.pi))
    speed_limits, energy_range = (4.0, 5.0, 5.0), (-11.0, -5.0)
    mjcf = """
    <mujoco>
      <option><flag contact="disable" energy="enable"/></option>
      <visual><headlight ambient=".45 .45 .45" diffuse=".5 .5 .5"/><map znear=".01"/></visual>
      <statistic extent="3"/>
      <asset>
        <texture name="sky" type="skybox" builtin="gradient" rgb1=".2 .25 .3" rgb2=".05 .05 .08" width="64" height="64"
                 mark="random" markrgb="1 1 1" random=".003"/>
      </asset>
      <worldbody>
        <light pos="1 -3 3" dir="-.3 .8 -.8" diffuse=".5 .5 .5" castshadow="false"/>
        <camera pos="0 -3.6 -.1" zaxis="0 -1 0"/>
        <geom type="cylinder" fromto="0 -.06 0 0 .06 0" size=".05" rgba=".8 .8 .8 1"/>
        <body>
          <joint type="hinge" axis="0 1 0"/>
          <geom type="capsule" fromto="0 0 0 0 0 .42" size=".025" mass="0" rgba=".7 .7 .7 1"/>
          <geom name="first" type="sphere" pos="0 0 .42" size=".13" mass=".5" rgba=".95 .25 .2 1"/>
          <body pos="0 0 .42">
            <joint type="hinge" axis="0 1 0"/>
            <geom type="capsule" fromto="0 0 0 0 0 .42" size=".025" mass="0" rgba=".7 .7 .7 1"/>
            <geom name="second" type="sphere" pos="0 0 .42" size=".13" mass=".5" rgba=".2 .9 .3 1"/>
            <body pos="0 0 .42">
              <joint type="hinge" axis="0 1 0"/>
              <geom type="capsule" fromto="0 0 0 0 0 .42" size=".025" mass="0" rgba=".7 .7 .7 1"/>
              <geom name="third" type="sphere" pos="0 0 .42" size=".13" mass=".5" rgba=".25 .55 1 1"/>
            </body>
          </body>
        </body>
      </worldbody>
    </mujoco>
    """

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """The distance from the pivot and both distances between neighbours are constant."""
        from keycld.mechanics import Constraints, DistanceToPoint, FixedDistance

        pivot = tuple(self.to_image_plane(np.zeros(2)).tolist())
        items = (DistanceToPoint("first", pivot), FixedDistance("first", "second"), FixedDistance("second", "third"))
        return Constraints(keypoints=self.keypoints, items=items)

    def places(self, q: np.ndarray) -> np.ndarray:
        """Return the centres of the bobs."""
        angle = np.cumsum(q, axis=-1)
        return np.cumsum(LENGTH * np.stack([np.sin(angle), np.cos(angle)], axis=-1), axis=-2)
