"""Two bodies that attract each other."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.systems.base import Conditions
from keycld.systems.registry import register
from keycld.systems.zoo.base import AbstractZooSystem

if TYPE_CHECKING:
    import keycld.mechanics

HEAVY, LIGHT = 1.0, 0.6
STRENGTH, SOFTENING = 1.6, 0.25


@register
class TwoBodies(AbstractZooSystem):
    """mᵢ r̈ᵢ = ± κ d / (|d|² + ε²)^1.5 with d = r₂ − r₁: V = −κ / √(|d|² + ε²).

    m₁ = 1 kg, m₂ = 0.6 kg, κ = 1.6 J m, ε = 0.25 m; no other force. Initial states: distances 0.6 to 0.95 m, across
    them 0.8 to 1.08 times the speed of a circle, along them ± 0.1 m/s; the centre of mass within 0.08 m of the middle,
    with a drift to 0.02 m/s. State: x and z of both bodies in m, their velocities. Two keypoints, the bodies, free in
    the plane: no constraint. Source: softened gravity (Plummer).
    """

    name = "zoo/two_bodies"
    dt = 1 / 30
    state_names = (
        "heavy_x", "heavy_z", "light_x", "light_z",
        "heavy_x_velocity", "heavy_z_velocity", "light_x_velocity", "light_z_velocity",
    )  # fmt: skip
    units = ("m",) * 4 + ("m/s",) * 4
    keypoints = ("heavy", "light")
    camera_height, camera_distance = 0.0, 3.0
    # Of the sweeps alone: initial states are sampled otherwise.
    position_ranges = ((-0.9, -0.1), (-0.6, 0.6), (0.1, 0.9), (-0.6, 0.6))
    mjcf = """
    <mujoco>
      <option gravity="0 0 0"><flag contact="disable" energy="enable"/></option>
      <visual><headlight ambient=".5 .5 .5" diffuse=".6 .6 .6"/><map znear=".01"/></visual>
      <statistic extent="3"/>
      <asset>
        <texture name="sky" type="skybox" builtin="gradient" rgb1=".02 .02 .1" rgb2=".12 .05 .2" width="128"
                 height="128" mark="random" markrgb=".8 .8 .9" random=".01"/>
      </asset>
      <worldbody>
        <light pos="-2 -2 2" dir="1 .8 -.8" diffuse=".4 .4 .4" castshadow="false"/>
        <camera pos="0 -3 0" zaxis="0 -1 0"/>
        <body>
          <joint type="slide" axis="1 0 0"/>
          <joint type="slide" axis="0 0 1"/>
          <geom name="heavy" type="sphere" size=".17" mass="1" rgba="1 .6 .15 1"/>
        </body>
        <body>
          <joint type="slide" axis="1 0 0"/>
          <joint type="slide" axis="0 0 1"/>
          <geom name="light" type="sphere" size=".12" mass=".6" rgba=".3 .8 1 1"/>
        </body>
      </worldbody>
    </mujoco>
    """

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """None: both bodies are free in the plane."""
        from keycld.mechanics import Constraints

        return Constraints(keypoints=self.keypoints)

    def places(self, q: np.ndarray) -> np.ndarray:
        """Return the centres of both bodies."""
        return q.reshape(*q.shape[:-1], 2, 2)

    def force(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the attraction."""
        gap = q[2:] - q[:2]
        pull = STRENGTH * gap / (gap @ gap + SOFTENING**2) ** 1.5
        return np.concatenate([pull, -pull])

    def potential(self, q: np.ndarray) -> float:
        """Return −κ / √(|d|² + ε²)."""
        gap = q[2:] - q[:2]
        return -STRENGTH / float(np.sqrt(gap @ gap + SOFTENING**2))

    def initial_values(self, random: np.random.RandomState, conditions: Conditions) -> tuple[np.ndarray, np.ndarray]:
        """Sample a bound orbit around the middle of the picture."""
        distance, angle = random.uniform(0.6, 0.95), random.uniform(-np.pi, np.pi)
        along = np.array([np.cos(angle), np.sin(angle)])
        across = random.choice([-1.0, 1.0]) * np.array([-along[1], along[0]])
        reduced = HEAVY * LIGHT / (HEAVY + LIGHT)
        circle = distance * np.sqrt(STRENGTH / (reduced * (distance**2 + SOFTENING**2) ** 1.5))
        velocity = random.uniform(0.8, 1.08) * circle * across + random.uniform(-0.1, 0.1) * along
        shares = np.array([[-LIGHT], [HEAVY]]) / (HEAVY + LIGHT)
        centre, drift = random.uniform(-0.08, 0.08, size=2), random.uniform(-0.02, 0.02, size=2)
        return (centre + shares * distance * along).ravel(), (drift + shares * velocity).ravel()
