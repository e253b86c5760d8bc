"""A four-bar linkage: crank, coupler and rocker."""

from typing import TYPE_CHECKING, Any

import numpy as np

from keycld.systems.registry import register
from keycld.systems.zoo.loop import AbstractLoop, Joints

if TYPE_CHECKING:
    import keycld.mechanics

CRANK, COUPLER, ROCKER = 0.35, 1.0, 0.7
PIVOTS = np.array([[-0.5, 0.0], [0.5, 0.0]])
# Of the third point of the coupler: along it from the crank's end, and to its left.
POINT = (0.5, 0.35)


@register
class FourBar(AbstractLoop):
    """J(θ) θ̈ + J'(θ) θ̇² / 2 = −V'(θ) with θ the crank's angle: L = J(θ) θ̇² / 2 − V(θ).

    Crank (0.35 m) and rocker (0.7 m) turn around pivots 1 m apart. A coupler of 1 m joins their ends; the rocker's end
    is above the line from the crank's end to the rocker's pivot. The coupler is a triangle: its third point lies 0.5 m
    along it and 0.35 m above it. Spheres at the crank's end (0.5 kg), the third point (0.3 kg) and the rocker's end
    (0.5 kg), with ρ = 0.12 m and Iᵢ = 2/5 mᵢ ρ², carry all mass and turn with crank, coupler and rocker:
    J = Σ mᵢ |rᵢ'|² + Iᵢ φᵢ'², V = g Σ mᵢ zᵢ, g = 9.81 m/s²; no friction. The crank can turn all the way round
    (Grashof). State: θ in rad (0 upright, positive to the right), θ̇ in rad/s. Three keypoints, the spheres: two
    distances from pivots, three within the coupler.
    """

    name = "zoo/four_bar"
    dt = 1 / 40
    state_names, units = ("angle", "angular_velocity"), ("rad", "rad/s")
    keypoints = ("crank", "point", "rocker")
    camera_height, camera_distance = 0.3, 3.2
    position_ranges, speed_limits, energy_range = ((-np.pi, np.pi),), (11.0,), (4.0, 9.0)
    mjcf = """
    <mujoco>
      <option><flag contact="disable" energy="enable"/></option>
      <visual><headlight ambient=".5 .5 .5" diffuse=".4 .4 .4"/><map znear=".01"/></visual>
      <statistic extent="3"/>
      <asset>
        <texture name="sky" type="skybox" builtin="flat" rgb1=".25 .3 .25" rgb2=".25 .3 .25" width="32" height="32"/>
        <texture name="wall" type="2d" builtin="gradient" rgb1=".35 .4 .3" rgb2=".15 .2 .15" width="64" height="64"/>
        <material name="wall" texture="wall"/>
      </asset>
      <worldbody>
        <light pos="-1 -3 3" dir=".25 .8 -.7" diffuse=".6 .6 .6"/>
        <camera pos="0 -3.2 .3" zaxis="0 -1 0"/>
        <geom type="plane" size="3 3 .25" pos="0 .4 .3" zaxis="0 -1 0" material="wall"/>
        <geom type="cylinder" fromto="-.5 .05 0 -.5 .3 0" size=".07" rgba=".1 .1 .1 1"/>
        <geom type="cylinder" fromto=".5 .05 0 .5 .3 0" size=".07" rgba=".1 .1 .1 1"/>
        <body pos="-.5 0 0">
          <joint type="hinge" axis="0 1 0"/>
          <geom type="capsule" fromto="0 0 0 0 0 .35" size=".035" mass="0" rgba=".85 .85 .8 1"/>
          <geom name="crank" type="sphere" pos="0 0 .35" size=".12" mass=".5" rgba=".95 .2 .15 1"/>
          <body pos="0 0 .35">
            <joint type="hinge" axis="0 1 0"/>
            <geom type="capsule" fromto="0 0 0 0 0 1" size=".025" mass="0" rgba=".85 .85 .8 1"/>
            <geom type="capsule" fromto="0 0 0 -.35 0 .5" size=".025" mass="0" rgba=".85 .85 .8 1"/>
            <geom type="capsule" fromto="0 0 1 -.35 0 .5" size=".025" mass="0" rgba=".85 .85 .8 1"/>
            <geom name="point" type="sphere" pos="-.35 0 .5" size=".12" mass=".3" rgba="1 .85 .1 1"/>
          </body>
        </body>
        <body pos=".5 0 0">
          <joint type="hinge" axis="0 1 0"/>
          <geom type="capsule" fromto="0 0 0 0 0 .7" size=".035" mass="0" rgba=".85 .85 .8 1"/>
          <geom name="rocker" type="sphere" pos="0 0 .7" size=".12" mass=".5" rgba=".2 .6 1 1"/>
        </body>
      </worldbody>
    </mujoco>
    """

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """Both links' distances from their pivots and the three distances within the coupler are constant."""
        from keycld.mechanics import Constraints, DistanceToPoint, FixedDistance

        first, second = (tuple(pivot.tolist()) for pivot in self.to_image_plane(PIVOTS))
        items = (
            DistanceToPoint("crank", first),
            DistanceToPoint("rocker", second),
            FixedDistance("crank", "rocker"),
            FixedDistance("crank", "point"),
            FixedDistance("rocker", "point"),
        )
        return Constraints(keypoints=self.keypoints, items=items)

    def places(self, q: np.ndarray) -> np.ndarray:
        """Return the centres of the spheres at the crank's end, at the coupler's point and at the rocker's end."""
        crank, coupler, rocker = _links(q[..., 0])
        point = crank + (POINT[0] + 1j * POINT[1]) * coupler / COUPLER
        spheres = np.stack([PIVOTS[0, 0] + crank, PIVOTS[0, 0] + point, PIVOTS[1, 0] + rocker], axis=-1)
        return np.stack([np.real(spheres), np.imag(spheres)], axis=-1)

    def follow(self, angle: float) -> Joints:
        """Return the angles of crank, coupler (relative) and rocker, from the closed loop and its derivatives."""
        crank, coupler, rocker = _links(angle)
        # A link at the angle φ from upright is i |link| exp(−iφ): its derivatives in φ are −i and −1 times itself.
        middle, end = _solve(coupler, rocker, -crank)
        middle_curvature, end_curvature = _solve(coupler, rocker, 1j * (crank + coupler * middle**2 - rocker * end**2))
        angles = np.angle(1j / np.array([coupler, rocker]))
        return Joints(
            np.array([angle, angles[0] - angle, angles[1]]),
            np.array([1.0, middle - 1.0, end]),
            np.array([0.0, middle_curvature, end_curvature]),
        )


def _links(angle: Any) -> tuple[Any, Any, Any]:
    """Return crank, coupler and rocker as complex numbers x + i z for angles of the crank."""
    crank = 1j * CRANK * np.exp(-1j * angle)
    gap = PIVOTS[1, 0] - PIVOTS[0, 0] - crank
    distance = np.abs(gap)
    along = (COUPLER**2 - ROCKER**2 + distance**2) / (2 * distance)
    coupler = (along + 1j * np.sqrt(COUPLER**2 - along**2)) * gap / distance
    return crank, coupler, coupler - gap


def _solve(coupler: complex, rocker: complex, right: complex) -> tuple[float, float]:
    """Solve coupler β − rocker γ = right for real β and γ."""
    area = (coupler * rocker.conjugate()).imag
    return (right * rocker.conjugate()).imag / area, (right * coupler.conjugate()).imag / area
