"""Simulated clips as a camera might record them: friction, textured ground, noise, shadows, pivots anywhere.

python validation/drawn_clips.py OUT [--seed 0]    # one MP4 of each kind
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from keycld.drawing import save_movie

SIDE = 128


class Camera(NamedTuple):
    """How a clip is recorded: its frames, their rate, the angle by which the picture is turned, degrees, and by how
    much the exposure varies, a standard deviation as a share of it."""

    frames: int = 300
    fps: float = 30.0
    tilt: float = 0.0
    exposure: float = 0.0


class Drawn(NamedTuple):
    """Frames, and the constants that `keycld watch` measures, by their names in physics.json."""

    frames: np.ndarray
    truth: dict[str, float]


def integrated(rate: Callable[[np.ndarray], np.ndarray], start: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the states of all frames of ṡ = rate(s), by Runge–Kutta steps of an eighth of a frame."""
    found, s, h = [], np.array(start, float), 1 / camera.fps / 8
    for _ in range(camera.frames):
        found.append(s)
        for _ in range(8):
            a = rate(s)
            b = rate(s + h / 2 * a)
            c = rate(s + h / 2 * b)
            s = s + h / 6 * (a + 2 * b + 2 * c + rate(s + h * c))
    return np.array(found)


def oscillation(mass: np.ndarray, stiffness: np.ndarray, friction: np.ndarray) -> dict[str, float]:
    """Return periods, damping ratios and the viscous rate of M q̈ + C q̇ + K q = 0."""
    factor = np.linalg.inv(np.linalg.cholesky(mass))
    squares, modes = np.linalg.eigh(factor @ stiffness @ factor.T)
    damping = np.diag(modes.T @ factor @ friction @ factor.T @ modes)
    found = {"viscous_rate": float(np.trace(np.linalg.solve(mass, friction)) / len(mass))}
    for k, (square, rate) in enumerate(zip(squares, damping, strict=True), 1):
        found |= {f"period_{k}": 2 * np.pi / np.sqrt(square), f"damping_ratio_{k}": rate / 2 / np.sqrt(square)}
    return {name: float(value) for name, value in found.items()}


def single(square: float, friction: float) -> dict[str, float]:
    """Return these of one degree of freedom: ω² and γ."""
    return oscillation(np.eye(1), np.full((1, 1), square), np.full((1, 1), friction))


def pendulum(start: np.ndarray, square: float, friction: float, camera: Camera) -> np.ndarray:
    """θ̈ = −ω² sin θ − γ θ̇; angles from hanging straight down."""
    return integrated(lambda s: np.array([s[1], -square * np.sin(s[0]) - friction * s[1]]), start, camera)[:, 0]


def hanging(lengths: tuple[float, float], masses: tuple[float, float], friction: float) -> dict[str, float]:
    """Return the constants of `double_pendulum`, for angles from the vertical."""
    (l1, l2), (m1, m2), g = lengths, masses, 8.0
    mass = np.array([[(m1 + m2) * l1**2, m2 * l1 * l2], [m2 * l1 * l2, m2 * l2**2]])
    weight = np.diag([(m1 + m2) * g * l1, m2 * g * l2])
    return oscillation(mass, weight, friction * np.array([[2.0, -1.0], [-1.0, 1.0]])) | {
        "mass_ratio_elbow_tip": m1 / m2
    }


def double_pendulum(
    start: np.ndarray, lengths: tuple[float, float], masses: tuple[float, float], friction: float, camera: Camera
) -> np.ndarray:
    """Two point masses on massless links in gravity of 8 units/s², and friction γ in both joints."""
    (l1, l2), (m1, m2), g = lengths, masses, 8.0

    def rate(s: np.ndarray) -> np.ndarray:
        a, b, va, vb = s
        c, d = np.cos(a - b), np.sin(a - b)
        matrix = np.array([[(m1 + m2) * l1**2, m2 * l1 * l2 * c], [m2 * l1 * l2 * c, m2 * l2**2]])
        force = np.array(
            [
                -m2 * l1 * l2 * d * vb**2 - (m1 + m2) * g * l1 * np.sin(a) - friction * (2 * va - vb),
                m2 * l1 * l2 * d * va**2 - m2 * g * l2 * np.sin(b) - friction * (vb - va),
            ]
        )
        return np.array([va, vb, *np.linalg.solve(matrix, force)])

    return integrated(rate, start, camera)[:, :2]


def cart_pole(
    start: np.ndarray, length: float, masses: tuple[float, float], spring: float, friction: float, camera: Camera
) -> np.ndarray:
    """A cart of mass M on a spring, and a point mass on a massless pole that hangs from it."""
    (big, small), g = masses, 8.0

    def rate(s: np.ndarray) -> np.ndarray:
        x, a, vx, va = s
        matrix = np.array([[big + small, small * length * np.cos(a)], [small * length * np.cos(a), small * length**2]])
        force = np.array(
            [
                small * length * np.sin(a) * va**2 - spring * x - friction * vx,
                -small * g * length * np.sin(a) - 0.1 * friction * va,
            ]
        )
        return np.array([vx, va, *np.linalg.solve(matrix, force)])

    return integrated(rate, start, camera)[:, :2]


class Canvas:
    """Frames of a camera: shapes over a ground with slow shades, blurred by a part of the exposure, with noise."""

    def __init__(self, random: np.random.Generator, camera: Camera):
        """Choose the ground."""
        self.random = random
        cosine, sine = np.cos(np.radians(camera.tilt)), np.sin(np.radians(camera.tilt))
        self.turn = np.array([[cosine, sine], [-sine, cosine]])
        rows, columns = np.mgrid[:SIDE, :SIDE] / SIDE
        tone, shade = random.uniform(0.35, 0.75, 3) * [1, 1, 1], random.uniform(-0.1, 0.1, 2)
        ground = tone + (shade[0] * rows + shade[1] * columns)[..., None]
        bars = random.uniform(0.0, 1.0, 3)
        for place, width in ((0.15, 0.03), (0.8, 0.05)):
            ground = np.where((np.abs(columns - place) < width / 2)[..., None], 0.6 * ground + 0.2 * bars, ground)
        self.ground = ground + 0.02 * random.standard_normal((SIDE, SIDE, 1))
        self.frames = np.repeat(self.ground[None], camera.frames, axis=0).astype(np.float32)
        step = 2 / (SIDE - 1)
        self.grid = np.stack([np.mgrid[:SIDE, :SIDE][1] * step - 1, 1 - np.mgrid[:SIDE, :SIDE][0] * step], -1)

    def colour(self) -> np.ndarray:
        """Return a colour that is well apart from the ground and from those before."""
        others = [self.ground.mean(axis=(0, 1)), *getattr(self, "used", [])]
        while True:
            found = self.random.uniform(0, 1, 3)
            if min(np.linalg.norm(found - other) for other in others) > 0.45:
                self.used = [*others[1:], found]
                return found

    def bar(self, first: np.ndarray, last: np.ndarray, width: float, colour: np.ndarray, opacity: float = 1.0) -> None:
        """Paint a bar with round ends from `first` to `last`, `[T, 2]` each."""
        shape = (len(self.frames), 2)
        for t in range(len(self.frames)):
            a, b = np.broadcast_to(first, shape)[t] @ self.turn, np.broadcast_to(last, shape)[t] @ self.turn
            along = b - a
            share = np.clip(((self.grid - a) @ along) / max(along @ along, 1e-12), 0, 1)
            far = np.linalg.norm(self.grid - a - share[..., None] * along, axis=-1)
            cover = opacity * np.clip((width - far) * (SIDE - 1) / 2 + 0.5, 0, 1)[..., None]
            self.frames[t] = (1 - cover) * self.frames[t] + cover * colour

    def ball(self, place: np.ndarray, radius: float, colour: np.ndarray) -> None:
        """Paint a disc at `[T, 2]`."""
        self.bar(place, place, radius, colour)

    def finished(self) -> np.ndarray:
        """Return the frames as bytes, with the noise of the camera."""
        noise = 0.012 * self.random.standard_normal(self.frames.shape)
        return np.round(255 * np.clip(self.frames + noise, 0, 1)).astype(np.uint8)


def _end(angle: np.ndarray, length: float) -> np.ndarray:
    return length * np.stack([np.sin(angle), -np.cos(angle)], axis=1)


def damped_pendulum(random: np.random.Generator, camera: Camera) -> Drawn:
    """A ball on a rod, with a shadow of the ball on the wall."""
    canvas, pivot, length = Canvas(random, camera), random.uniform(-0.25, 0.25, 2) + [0, 0.2], random.uniform(0.5, 0.7)
    start, square, friction = random.uniform(0.7, 1.3), random.uniform(8, 14), random.uniform(0.05, 0.2)
    angle = pendulum(np.array([start, 0]), square, friction, camera)
    ball = pivot + _end(angle, length)
    canvas.bar(ball + [0.08, -0.05], ball + [0.08, -0.05], 0.1, np.zeros(3), opacity=0.25)
    canvas.bar(pivot, ball, 0.02, canvas.colour())
    canvas.ball(ball, random.uniform(0.07, 0.11), canvas.colour())
    return Drawn(canvas.finished(), single(square, friction) | {"gravity_direction": camera.tilt - 90})


def hidden_pivot(random: np.random.Generator, camera: Camera) -> Drawn:
    """A ball on a thread from a pivot above of the picture."""
    canvas, length = Canvas(random, camera), random.uniform(1.4, 1.8)
    start, square, friction = random.uniform(0.35, 0.45), random.uniform(6, 9), random.uniform(0.03, 0.1)
    angle = pendulum(np.array([start, 0]), square, friction, camera)
    canvas.ball(np.array([random.uniform(-0.1, 0.1), 1.0]) + _end(angle, length), 0.1, canvas.colour())
    return Drawn(canvas.finished(), single(square, friction) | {"gravity_direction": camera.tilt - 90})


def damped_double_pendulum(random: np.random.Generator, camera: Camera) -> Drawn:
    """Two bars that cover each other, with friction in the joints."""
    canvas, pivot = Canvas(random, camera), random.uniform(-0.15, 0.15, 2)
    lengths = random.uniform(0.32, 0.42), random.uniform(0.25, 0.35)
    start = np.array([*random.uniform(1.2, 2.4, 2), 0, 0])
    masses = (1.0, random.uniform(0.4, 1.0))
    angles = double_pendulum(start, lengths, masses, 0.004, camera)
    elbow = pivot + _end(angles[:, 0], lengths[0])
    canvas.bar(elbow, elbow + _end(angles[:, 1], lengths[1]), 0.05, canvas.colour())
    canvas.bar(pivot, elbow, 0.05, canvas.colour())
    return Drawn(canvas.finished(), hanging(lengths, masses, 0.004) | {"gravity_direction": camera.tilt - 90})


def two_balls(random: np.random.Generator, camera: Camera) -> Drawn:
    """A double pendulum of which two balls of one colour are seen."""
    canvas, pivot = Canvas(random, camera), random.uniform(-0.15, 0.15, 2)
    lengths, colour = (random.uniform(0.35, 0.42), random.uniform(0.28, 0.36)), canvas.colour()
    masses = (1.0, 0.7)
    angles = double_pendulum(np.array([*random.uniform(1.0, 2.0, 2), 0, 0]), lengths, masses, 0.004, camera)
    elbow = pivot + _end(angles[:, 0], lengths[0])
    canvas.ball(elbow, 0.06, colour)
    canvas.ball(elbow + _end(angles[:, 1], lengths[1]), 0.06, colour)
    return Drawn(canvas.finished(), hanging(lengths, masses, 0.004) | {"gravity_direction": camera.tilt - 90})


class _Rail(NamedTuple):
    """A cart on a spring, on a rail of any direction: what it is drawn on, its places, and its constants."""

    canvas: Canvas
    along: np.ndarray
    middle: np.ndarray
    cart: np.ndarray
    truth: dict[str, float]


def _rail(random: np.random.Generator, camera: Camera, swing: tuple[float, float]) -> _Rail:
    """Return a cart that begins between two distances from the middle of its swing."""
    canvas, tilt = Canvas(random, camera), random.uniform(-0.4, 0.4)
    along = np.array([np.cos(tilt), np.sin(tilt)])
    middle = random.uniform(-0.15, 0.15, 2)
    square, friction = random.uniform(10, 30), random.uniform(0.05, 0.25)
    x = pendulum(np.array([0.01, 0.0]), square, friction, camera) / 0.01 * random.uniform(*swing)
    return _Rail(canvas, along, middle, middle + x[:, None] * along, single(square, friction))


def spring_cart(random: np.random.Generator, camera: Camera) -> Drawn:
    """A cart on a rail of any direction, on a zigzag spring."""
    canvas, along, middle, cart, truth = _rail(random, camera, (0.25, 0.4))
    wall, across = middle - 0.8 * along, np.array([-along[1], along[0]])
    metal = canvas.colour()
    knots = [wall + (cart - wall) * share + across * side * 0.05 for share, side in _ZIGZAG]
    for first, last in zip(knots[:-1], knots[1:], strict=True):
        canvas.bar(first, last, 0.012, metal)
    canvas.bar(cart - 0.1 * along, cart + 0.1 * along, 0.09, canvas.colour())
    return Drawn(canvas.finished(), truth)


def short_swing(random: np.random.Generator, camera: Camera) -> Drawn:
    """A cart that moves by less than its length; its spring is not seen."""
    canvas, along, _, cart, truth = _rail(random, camera, (0.08, 0.14))
    canvas.bar(cart - 0.1 * along, cart + 0.1 * along, 0.09, canvas.colour())
    return Drawn(canvas.finished(), truth)


def hanging_cart_pole(random: np.random.Generator, camera: Camera) -> Drawn:
    """A cart on a level rail with a pole that hangs from it."""
    canvas, length, place = Canvas(random, camera), random.uniform(0.4, 0.55), np.array([0.0, random.uniform(0.2, 0.4)])
    start, masses, spring, friction = [random.uniform(-0.4, 0.4), random.uniform(0.8, 1.4), 0, 0], (1.0, 0.6), 6.0, 0.05
    motion = cart_pole(np.array(start), length, masses, spring, friction, camera)
    mass = np.array([[sum(masses), masses[1] * length], [masses[1] * length, masses[1] * length**2]])
    truth = oscillation(mass, np.diag([spring, masses[1] * 8.0 * length]), np.diag([friction, 0.1 * friction]))
    cart = place + motion[:, :1] * np.array([1.0, 0.0])
    canvas.bar(cart, cart + _end(motion[:, 1], length), 0.035, canvas.colour())
    canvas.bar(cart - [0.1, 0], cart + [0.1, 0], 0.07, canvas.colour())
    return Drawn(canvas.finished(), truth)


_ZIGZAG = [(k / 12, (-1) ** k * (0 < k < 12)) for k in range(13)]
KINDS = {
    "damped_pendulum": (damped_pendulum, "pendulum"),
    "hidden_pivot": (hidden_pivot, "pendulum"),
    "damped_double_pendulum": (damped_double_pendulum, "double-pendulum"),
    "two_balls": (two_balls, "double-pendulum"),
    "spring_cart": (spring_cart, "spring"),
    "hanging_cart_pole": (hanging_cart_pole, "cart-pole"),
    "short_swing": (short_swing, "spring"),
}
"""What is drawn, and the mechanism that it shows."""


def drawn(kind: str, seed: int, camera: Camera = Camera()) -> Drawn:  # noqa: B008
    """Return the clip of a kind and a seed."""
    found = KINDS[kind][0](np.random.default_rng([seed, list(KINDS).index(kind)]), camera)
    if not camera.exposure:
        return found
    # It rises and falls in five seconds.
    level = 0.95 + camera.exposure * np.sqrt(2) * np.sin(2 * np.pi * np.arange(camera.frames) / camera.fps / 5)
    frames = np.round(found.frames * level[:, None, None, None])
    return found._replace(frames=np.clip(frames, 0, 255).astype(np.uint8))


def main() -> None:
    """Draw one clip of each kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for kind in KINDS:
        frames = drawn(kind, options.seed).frames
        save_movie(options.out / f"{kind}-{options.seed}.mp4", frames, fps=Camera().fps, scale=1)
        print(options.out / f"{kind}-{options.seed}.mp4", frames.shape, flush=True)


if __name__ == "__main__":
    main()
