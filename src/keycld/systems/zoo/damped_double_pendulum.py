"""A double pendulum with viscous friction in both hinges and a motor in the first."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.systems.registry import register
from keycld.systems.zoo.base import AbstractZooSystem

if TYPE_CHECKING:
    import keycld.mechanics

UPPER, LOWER = 0.6, 0.5


@register
class DampedDoublePendulum(AbstractZooSystem):
    """Two bobs on massless rods: M(q) q̈ + c(q, q̇) = −∂V/∂q − d q̇ + (0.5 u, 0); E changes by 0.5 u θ̇₁ − d |q̇|² watts.

    Absolute angles α = θ₁, β = θ₁ + θ₂: T = (m₁ |ṙ₁|² + m₂ |ṙ₂|² + I₁ α̇² + I₂ β̇²) / 2, V = g (m₁ z₁ + m₂ z₂),
    r₁ = l₁ (sin α, cos α), r₂ = r₁ + l₂ (sin β, cos β). m₁ = 1 kg, m₂ = 0.6 kg, l₁ = 0.6 m, l₂ = 0.5 m,
    Iᵢ = 2/5 mᵢ ρᵢ² of spheres with ρ = 0.13 and 0.11 m, g = 9.81 m/s², d = 0.04 N m s in both hinges. State: θ₁ in rad
    (0 upright, positive to the right), θ₂ relative to the upper rod, their velocities; input: u in N m before the gear
    of 0.5. Two keypoints, the bobs: fixed distances pivot–first and first–second. Chaotic.
    """

    name = "zoo/damped_double_pendulum"
    dt = 1 / 50
    state_names = ("shoulder", "elbow", "shoulder_velocity", "elbow_velocity")
    units = ("rad", "rad", "rad/s", "rad/s")
    input_names = ("torque",)
    keypoints = ("upper", "lower")
    camera_height, camera_distance = 0.0, 3.1
    substeps = 8
    position_ranges, speed_limits, energy_range = ((0.0, 2 * np.pi), (-np.pi, np.pi)), (4.0, 5.0), (-10.5, -4.0)
    mjcf = """
    <mujoco>
      <option><flag contact="disable" energy="enable"/></option>
      <visual><headlight ambient=".4 .4 .4" diffuse=".5 .5 .5"/><map znear=".01"/></visual>
      <statistic extent="3"/>
      <asset>
        <texture name="sky" type="skybox" builtin="gradient" rgb1=".95 .8 .6" rgb2=".7 .4 .3" width="64" height="64"/>
        <material name="floor" rgba=".45 .3 .25 1" reflectance=".15"/>
      </asset>
      <worldbody>
        <light pos=".5 -.5 4" diffuse=".6 .6 .6"/>
        <camera pos="0 -3.1 0" zaxis="0 -1 0"/>
        <geom type="plane" size="8 8 .25" pos="0 0 -1.35" material="floor"/>
        <geom type="cylinder" fromto="0 -.06 0 0 .06 0" size=".05" rgba=".2 .2 .2 1"/>
        <body>
          <joint name="shoulder" type="hinge" axis="0 1 0" damping=".04"/>
          <geom type="capsule" fromto="0 0 0 0 0 .6" size=".03" mass="0" rgba=".2 .2 .2 1"/>
          <geom name="upper" type="sphere" pos="0 0 .6" size=".13" mass="1" rgba=".1 .35 .8 1"/>
          <body pos="0 0 .6">
            <joint name="elbow" type="hinge" axis="0 1 0" damping=".04"/>
            <geom type="capsule" fromto="0 0 0 0 0 .5" size=".03" mass="0" rgba=".2 .2 .2 1"/>
            <geom name="lower" type="sphere" pos="0 0 .5" size=".11" mass=".6" rgba=".05 .6 .2 1"/>
          </body>
        </body>
      </worldbody>
      <actuator><motor joint="shoulder" gear=".5" ctrllimited="true" ctrlrange="-3 3"/></actuator>
    </mujoco>
    """

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """|x₁| and |x₁ − x₂| are constant."""
        from keycld.mechanics import Constraints, DistanceToPoint, FixedDistance

        items = (DistanceToPoint("upper", (0.0, 0.0)), FixedDistance("upper", "lower"))
        return Constraints(keypoints=self.keypoints, items=items)

    def places(self, q: np.ndarray) -> np.ndarray:
        """Return the centres of the bobs."""
        angle = np.cumsum(q, axis=-1)[..., None]
        rods = np.array([[UPPER], [LOWER]]) * np.concatenate([np.sin(angle), np.cos(angle)], axis=-1)
        return np.cumsum(rods, axis=-2)
