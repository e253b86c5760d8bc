"""A slider-crank: a turning crank moves a slider through a rod."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.systems.registry import register
from keycld.systems.zoo.loop import AbstractLoop, Joints

if TYPE_CHECKING:
    import keycld.mechanics

CRANK, ROD = 0.35, 0.9


@register
class SliderCrank(AbstractLoop):
    """J(θ) θ̈ + J'(θ) θ̇² / 2 = −V'(θ) with θ the crank's angle: L = J(θ) θ̇² / 2 − V(θ).

    The crank (r = 0.35 m, massless) turns around a pivot at the height of the slider and carries a pin of 0.5 kg with
    inertia 0.0024 kg m². A uniform rod (l = 0.9 m, 0.2 kg, inertia 0.0135 kg m²) joins the pin to a slider of 1 kg on
    a horizontal line. The rod's angle β has cos β = −(r / l) cos θ, sin β > 0. J = Σ mᵢ |rᵢ'|² + Iᵢ φᵢ'² over pin, rod
    and slider, V = g (0.5 z_pin + 0.2 z_rod), g = 9.81 m/s²; no friction. State: θ in rad (0 upright, positive to the
    right), θ̇ in rad/s. Two keypoints, pin and slider: distances pivot–pin and pin–slider, slider on a line.
    """

    name = "zoo/slider_crank"
    dt = 1 / 40
    state_names, units = ("angle", "angular_velocity"), ("rad", "rad/s")
    keypoints = ("pin", "slider")
    camera_offset, camera_height, camera_distance = 0.5, 0.1, 3.0
    substeps = 8
    position_ranges, speed_limits, energy_range = ((-np.pi, np.pi),), (11.0,), (-1.2, 3.5)
    mjcf = """
    <mujoco>
      <option><flag contact="disable" energy="enable"/></option>
      <visual><headlight ambient=".45 .45 .45" diffuse=".4 .4 .4"/><map znear=".01"/></visual>
      <statistic extent="3"/>
      <asset>
        <texture name="sky" type="skybox" builtin="gradient" rgb1=".85 .85 .9" rgb2=".55 .6 .7" width="64" height="64"/>
        <texture name="floor" type="2d" builtin="checker" rgb1=".35 .4 .45" rgb2=".45 .5 .55" width="64" height="64"/>
        <material name="floor" texture="floor" texrepeat="1 1" texuniform="true" reflectance=".1"/>
      </asset>
      <worldbody>
        <light pos="1 -2 4" dir="-.1 .4 -1" diffuse=".6 .6 .6"/>
        <camera pos=".5 -3 .1" zaxis="0 -1 0"/>
        <geom type="plane" size="8 8 .25" pos="0 0 -.55" material="floor"/>
        <geom type="cylinder" fromto="0 .1 0 0 .2 0" size=".22" rgba=".3 .3 .35 1"/>
        <geom type="box" size=".55 .06 .03" pos=".9 .06 -.2" rgba=".3 .3 .35 1"/>
        <body>
          <joint type="hinge" axis="0 1 0"/>
          <inertial pos="0 0 .35" mass=".5" diaginertia=".0024 .0024 .0024"/>
          <geom type="capsule" fromto="0 0 0 0 0 .35" size=".05" rgba=".2 .2 .25 1"/>
          <geom name="pin" type="sphere" pos="0 0 .35" size=".12" rgba=".9 .45 .05 1"/>
          <body pos="0 0 .35">
            <joint type="hinge" axis="0 1 0"/>
            <inertial pos="0 0 .45" mass=".2" diaginertia=".0135 .0135 .0001"/>
            <geom type="capsule" fromto="0 0 0 0 0 .9" size=".03" rgba=".95 .95 .95 1"/>
            <body pos="0 0 .9">
              <joint type="hinge" axis="0 1 0"/>
              <geom name="slider" type="box" size=".15 .06 .14" pos="0 .03 0" mass="1" rgba=".1 .3 .75 1"/>
            </body>
          </body>
        </body>
      </worldbody>
    </mujoco>
    """

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """The distances pivot–pin and pin–slider and the slider's y are constant."""
        from keycld.mechanics import Constraints, DistanceToPoint, FixedDistance, OnLine

        pivot = tuple(self.to_image_plane(np.zeros(2)).tolist())
        items = (DistanceToPoint("pin", pivot), FixedDistance("pin", "slider"), OnLine("slider", direction=(1.0, 0.0)))
        return Constraints(keypoints=self.keypoints, items=items)

    def places(self, q: np.ndarray) -> np.ndarray:
        """Return the centres of the pin and of the slider."""
        pin = CRANK * np.stack([np.sin(q[..., 0]), np.cos(q[..., 0])], axis=-1)
        reach = np.sqrt(ROD**2 - pin[..., 1] ** 2)
        slider = np.stack([pin[..., 0] + reach, np.zeros_like(reach)], axis=-1)
        return np.stack([pin, slider], axis=-2)

    def follow(self, angle: float) -> Joints:
        """Return the angles of crank, rod (relative) and slider, which stays level."""
        sine, cosine = np.sin(angle), np.cos(angle)
        rod = np.arccos(-CRANK / ROD * cosine)
        slope = -CRANK / ROD * sine / np.sin(rod)
        curvature = -(CRANK / ROD * cosine + np.cos(rod) * slope**2) / np.sin(rod)
        return Joints(
            np.array([angle, rod - angle, -rod]),
            np.array([1.0, slope - 1.0, -slope]),
            np.array([0.0, curvature, -curvature]),
        )
