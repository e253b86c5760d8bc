"""Rooms with five objects: their random furniture, and a scene as one vector."""

import colorsys
import math

import numpy as np
from jaxtyping import Float

OBJECTS = 5
SHAPES = ("sphere", "capsule", "cylinder", "box")
# Objects stand within this distance of the room's centre, so that the camera, at distance 1, never meets one.
_SPREAD = 0.65
_GAP = 0.03
_MOST_SAMPLES = 10_000
# A scene as one vector: colours of floor and wall; then for each object shape, place, yaw, three sizes, colour.
COLOURS, OBJECT = 6, 10


def sample_scene(random: np.random.RandomState) -> dict[str, np.ndarray]:
    """Sample a room; lengths in units of the camera's distance from the centre.

    Each object is a sphere, capsule, cylinder or box, all equally likely, upright, turned by any angle about the
    vertical, with a radius (half width) of 0.08 to 0.16 and a half height of 0.08 to 0.2, somewhere on the floor within
    0.65 of the centre; objects do not touch. Every colour has a random hue, floor and wall a saturation of 0.3 to 0.7,
    objects one of 0.7 to 1. Shapes and colours are the paper's, the numbers ours: it gives none.
    """
    size = np.empty((OBJECTS, 3))
    shape = random.randint(len(SHAPES), size=OBJECTS)
    for k, name in enumerate(SHAPES[i] for i in shape):
        radius, half = random.uniform(0.08, 0.16), random.uniform(0.08, 0.2)
        size[k] = {
            "sphere": (radius, radius, radius),
            "capsule": (radius, half / 2, half / 2),
            "cylinder": (radius, half, half),
            "box": (radius, random.uniform(0.08, 0.16), half),
        }[name]
    return {
        "shape": shape,
        "place": _places(random, np.where(shape == 3, np.hypot(size[:, 0], size[:, 1]), size[:, 0])),
        "yaw": random.uniform(-math.pi, math.pi, size=OBJECTS),
        "half_sizes": size,
        "color": np.stack([_colour(random, 0.7, 1.0) for _ in range(OBJECTS)]),
        "floor": _colour(random, 0.3, 0.7),
        "wall": _colour(random, 0.3, 0.7),
    }


def _colour(random: np.random.RandomState, dull: float, bright: float) -> np.ndarray:
    return np.array(colorsys.hsv_to_rgb(random.uniform(), random.uniform(dull, bright), random.uniform(0.6, 1.0)))


def _places(random: np.random.RandomState, reach: np.ndarray) -> np.ndarray:
    """Sample places on the floor, uniform over the disc, all of them again until none touch."""
    needed = reach[:, None] + reach[None, :] + _GAP
    for _ in range(_MOST_SAMPLES):
        distance, angle = _SPREAD * np.sqrt(random.uniform(size=OBJECTS)), random.uniform(0, 2 * math.pi, size=OBJECTS)
        place = np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=-1)
        gaps = np.linalg.norm(place[:, None] - place[None, :], axis=-1) + np.eye(OBJECTS)
        if np.all(gaps >= needed):
            return place
    raise RuntimeError(f"no room for objects of reach {reach}")


def scene_vector(scene: dict[str, np.ndarray]) -> Float[np.ndarray, "scene"]:
    """Return a scene as one vector, as `RoomRenderer` takes it."""
    objects = [scene["shape"][:, None], scene["place"], scene["yaw"][:, None], scene["half_sizes"], scene["color"]]
    return np.concatenate([scene["floor"], scene["wall"], np.concatenate(objects, axis=1).reshape(-1)])
