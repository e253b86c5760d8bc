"""Clips as a phone records them: a photographic ground, an exposure that drifts, a hand that is not quite still.

Parts are shaded, blurred by their motion and cast a soft shadow; there is noise of the sensor. `watched_clips.py`
watches them.
"""

import functools
from collections.abc import Callable

import numpy as np
from scipy import ndimage
from validation.drawn_clips import Camera, Drawn, double_pendulum, hanging, integrated, pendulum, single

# Height and width of pictures, and pixels of a clip's unit of length.
_SIZE, _UPRIGHT, _UNIT = (360, 640), (640, 360), 150.0
# Deviation of the exposure, of the hand in pixels, and of the sensor.
_EXPOSURE, _HAND, _NOISE = 0.025, 0.4, 5.0
# So many instants make a frame, over half of its time.
_INSTANTS = 3


class _Disc:
    """A ball that is lit from the upper left."""

    def __init__(self, place: np.ndarray, radius: float, colour: tuple[int, int, int]):
        self.place, self.radius, self.colour = place, radius, np.array(colour, float)

    def drawn(self, picture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        dx, dy = x - self.place[0], y - self.place[1]
        covers = np.clip(self.radius + 0.5 - np.hypot(dx, dy), 0, 1)[..., None]
        light = 1 - 0.35 * np.clip((dx + dy) / (2 * self.radius), -1, 1)[..., None]
        return picture * (1 - covers) + covers * self.colour * light

    def shade(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.clip(self.radius + 0.5 - np.hypot(x - self.place[0] - 18, y - self.place[1] - 10), 0, 1)


class _Link:
    """A straight rod or string."""

    def __init__(self, first: np.ndarray, second: np.ndarray, width: float, colour: tuple[int, int, int]):
        self.first, self.along = first, second - first
        self.width, self.colour = width, np.array(colour, float)

    def drawn(self, picture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        dx, dy = x - self.first[0], y - self.first[1]
        share = np.clip((dx * self.along[0] + dy * self.along[1]) / (self.along @ self.along + 1e-9), 0, 1)
        off = np.hypot(dx - share * self.along[0], dy - share * self.along[1])
        covers = np.clip(self.width / 2 + 0.5 - off, 0, 1)[..., None]
        return picture * (1 - covers) + covers * self.colour


_Parts = list[_Disc | _Link]


def phone_pendulum(
    random: np.random.Generator,
    camera: Camera,
    *,
    held: float = 0.0,
    caught: float | None = None,
    upright: bool = False,
) -> Drawn:
    """A ball on a string, from rest at some forty degrees, or twenty on a long string in an upright picture.

    A hand may hold it there at first, for so many seconds, and may catch it with so many left.
    """
    square, friction, fine = random.uniform(9, 13), random.uniform(0.05, 0.1), _fine(camera)
    begin = random.uniform(0.6, 0.9) * (0.5 if upright else 1.0)
    swing = pendulum(np.array([begin, 0.0]), square, friction, fine)
    still, end = round(held * fine.fps), fine.frames if caught is None else fine.frames - round(caught * fine.fps)
    angle = np.concatenate([np.full(still, swing[0]), swing])
    angle[end:] = angle[min(end, len(angle) - 1)]
    pivot, length = (np.array([175.0, 30.0]), 2.6) if upright else (np.array([330.0, 40.0]), 1.6)

    def ball(k: int) -> np.ndarray:
        return pivot + length * _UNIT * np.array([np.sin(angle[k]), np.cos(angle[k])])

    def parts(k: int) -> _Parts:
        hanging: _Parts = [_Link(pivot, ball(k), 2, (60, 55, 50)), _Disc(ball(k), 13, (190, 60, 50))]
        if held:
            hanging += _hand(ball(0), (k - still) / fine.fps)
        if caught is not None:
            hanging += _hand(ball(end), (end - k) / fine.fps)
        return hanging

    size = _UPRIGHT if upright else _SIZE
    return Drawn(_filmed(random, camera, parts, size), single(square, friction) | {"gravity_direction": -90.0})


def _hand(place: np.ndarray, seconds: float) -> _Parts:
    """A hand at a place, which it leaves to the right after second 0."""
    away = 900 * max(0.0, seconds) ** 2
    if away > 500:
        return []
    palm = place + np.array([22 + away, 4 - away / 5])
    arm = _Link(palm + np.array([15, 5]), palm + np.array([400, 150]), 46, (205, 160, 130))
    return [arm, _Disc(palm, 26, (215, 170, 140))]


def phone_spring(random: np.random.Generator, camera: Camera) -> Drawn:
    """A ball that bobs on a spring."""
    square, friction, fine = random.uniform(50, 70), random.uniform(0.08, 0.15), _fine(camera)
    state = integrated(lambda s: np.array([s[1], -square * s[0] - friction * s[1]]), np.array([0.37, 0.0]), fine)
    signs = np.array([0, *(-1.0 if k % 2 else 1.0 for k in range(12)), 0])

    def parts(k: int) -> _Parts:
        ball = np.array([300.0, 200 + _UNIT * state[k, 0]])
        turns = np.stack([300 + 9 * signs, np.linspace(10, ball[1] - 14, len(signs))], axis=1)
        links = [_Link(a, b, 2, (90, 90, 95)) for a, b in zip(turns[:-1], turns[1:], strict=True)]
        return [*links, _Disc(ball, 16, (60, 140, 70))]

    return Drawn(_filmed(random, camera, parts), single(square, friction))


def phone_double(random: np.random.Generator, camera: Camera) -> Drawn:
    """Two wooden links with weights at their ends."""
    lengths, masses = (random.uniform(0.55, 0.65), random.uniform(0.45, 0.55)), (1.0, random.uniform(0.6, 0.9))
    angles = double_pendulum(np.array([*random.uniform(0.5, 1.2, 2), 0, 0]), lengths, masses, 0.01, _fine(camera))
    pivot = np.array([320.0, 150.0])

    def parts(k: int) -> _Parts:
        one, two = (
            length * _UNIT * np.array([np.sin(a), np.cos(a)]) for a, length in zip(angles[k], lengths, strict=True)
        )
        elbow = pivot + one
        return [
            _Link(pivot, elbow, 7, (120, 85, 50)),
            _Link(elbow, elbow + two, 7, (180, 150, 110)),
            _Disc(elbow, 9, (60, 60, 65)),
            _Disc(elbow + two, 11, (200, 170, 50)),
            _Disc(pivot, 6, (70, 70, 70)),
        ]

    return Drawn(_filmed(random, camera, parts), hanging(lengths, masses, 0.01) | {"gravity_direction": -90.0})


def _fine(camera: Camera) -> Camera:
    """Return a camera with the instants of all frames, and as many between them."""
    return camera._replace(frames=2 * _INSTANTS * camera.frames, fps=2 * _INSTANTS * camera.fps)


def _filmed(
    random: np.random.Generator, camera: Camera, parts: Callable[[int], _Parts], size: tuple[int, int] = _SIZE
) -> np.ndarray:
    y, x = np.mgrid[: size[0], : size[1]].astype(float)
    ground = _ground(random, size)
    hand = ndimage.gaussian_filter1d(random.normal(size=(camera.frames, 2)), 2, axis=0)
    drift = ndimage.gaussian_filter1d(random.normal(size=camera.frames), 25)
    hand, drift = _HAND * hand / hand.std(), _EXPOSURE * drift / drift.std()
    frames = []
    for t in range(camera.frames):
        total = np.zeros_like(ground)
        for instant in range(_INSTANTS):
            now = parts(2 * _INSTANTS * t + instant)
            shade = np.max([part.shade(x, y) for part in now if isinstance(part, _Disc)], axis=0)
            picture = ground * (1 - 0.35 * ndimage.gaussian_filter(shade, 4)[..., None])
            for part in now:
                picture = part.drawn(picture, x, y)
            total += picture / _INSTANTS
        moved = ndimage.shift(total, (*hand[t], 0), order=1, mode="nearest") * (1 + drift[t])
        frames.append(np.clip(moved + random.normal(0, _NOISE, moved.shape), 0, 255).astype(np.uint8))
    return np.array(frames)


def _ground(random: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    """Return a blurred room: texture of all sizes, and some boxes."""
    texture = np.zeros((*size, 3))
    for scale, strength in ((80, 40), (25, 18), (6, 10), (1.5, 6)):
        noise = ndimage.gaussian_filter(random.normal(size=texture.shape), (scale, scale, 0))
        texture += strength * noise / noise.std()
    ground = 0.7 * texture.mean(axis=-1, keepdims=True) + 0.3 * texture + np.array([150.0, 140.0, 125.0])
    for _ in range(6):
        top, left = random.integers(0, size[0] - 60), random.integers(0, size[1] - 80)
        high, wide = random.integers(20, 60), random.integers(30, 80)
        box = ground[top : top + high, left : left + wide]
        box[:] = 0.3 * box + 0.7 * random.uniform(40, 210, 3)
    return np.clip(ground, 5, 250)


PHONE = {
    "phone_pendulum": (phone_pendulum, "pendulum"),
    "phone_hand": (functools.partial(phone_pendulum, held=1.0), "pendulum"),
    "phone_upright": (functools.partial(phone_pendulum, held=1.0, upright=True), "pendulum"),
    "phone_caught": (functools.partial(phone_pendulum, held=1.0, caught=1.5), "pendulum"),
    "phone_spring": (phone_spring, "spring"),
    "phone_double": (phone_double, "double-pendulum"),
}
"""What is filmed, and the mechanism that it shows."""
