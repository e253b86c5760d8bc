"""Keypoints observed in recordings, and how much of a motion a law may miss."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from keycld.mechanics import Own

# Share of the motion that a law may miss of the recordings that it was fitted to.
MISSED = 0.2
# Fits to up to so many recordings begin with short parts. Halves of them are fitted where the whole is missed, while
# constant accelerations miss this share of the motion in halves, and these have so many frames: a law must explain more
# than parabolas can.
SCARCE, _CURVED, _SHORTEST = 32, 2 * MISSED, 16


@dataclasses.dataclass(frozen=True)
class Tracks:
    """Keypoints observed in recordings, and what a fit to them needs.

    Attributes:
        x: observed keypoints `[N, T, 2K]`.
        u: inputs `[N, l]` or `[N, T, l]`.
        dt: seconds between frames.
        constants: values of Φ that all recordings share; None: each recording has its own.
        located: whether unknown numbers of the constraints stay where the positions alone put them; otherwise they are
            fitted with the dynamics.
        own: first guess and prior of the parameters that differ by recording; None: there are none.
        among: kinds of forces that a compiled fit to few recordings has, acting or not, so that one serves all laws
            with some of them: it is compiled for tens of seconds and runs for one.
    """

    x: jax.Array
    u: jax.Array
    dt: jax.Array
    constants: jax.Array | None
    located: bool = False
    own: Own | None = None
    among: tuple[str, ...] = ()

    def __getitem__(self, recordings: slice | np.ndarray) -> "Tracks":
        """Return some of the recordings."""
        own = self.own
        if own is not None:
            own = own._replace(numbers=own.numbers[recordings], expected=own.expected[recordings])
        return dataclasses.replace(self, x=self.x[recordings], u=self.u[recordings], own=own)

    def halved(self) -> "Tracks | None":
        """Return both halves of each recording; None of many recordings, and where parabolas nearly explain halves."""
        count, length, dim = self.x.shape
        half = length // 2
        if self.own is not None or 2 * count > SCARCE or half < _SHORTEST:
            return None
        halves = self.x[:, length - 2 * half :].reshape(2 * count, half, dim)
        if _rms(halves - nearest_polynomials(halves, 2)) < _CURVED * extent(halves):
            return None
        if self.u.ndim == 2:
            u = jnp.repeat(self.u, 2, axis=0)
        else:
            u = self.u[:, length - 2 * half : length].reshape(2 * count, half, self.u.shape[-1])
        return dataclasses.replace(self, x=halves, u=u)


def extent(x: jax.Array) -> float:
    """Return the root mean square of motions `[N, T, 2K]` around the mean position of each."""
    return _rms(x - jnp.mean(x, axis=1, keepdims=True))


def nearest_polynomials(paths: jax.Array, degree: int) -> jax.Array:
    """Return the nearest polynomials in time to paths `[N, T, …]`."""
    powers = np.vander(np.linspace(-1, 1, paths.shape[1]), degree + 1)
    projection = jnp.asarray(powers @ np.linalg.pinv(powers), paths.dtype)
    return jnp.einsum("st,nt...->ns...", projection, paths, precision="highest")


def _rms(x: jax.Array) -> float:
    return float(jnp.sqrt(jnp.mean(x**2)))
