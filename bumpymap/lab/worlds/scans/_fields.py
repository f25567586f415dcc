"""Periodic random fields: computed once on a small square, sampled anywhere, rotated so that periods do not align."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Field", "Floats", "log_uniform", "make_field", "smoothstep"]

Floats = NDArray[np.float64]


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number with a uniform logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def smoothstep(t: Floats) -> Floats:
    """Rise from 0 to 1 for t from 0 to 1, with level ends."""
    t = np.clip(t, 0.0, 1.0)
    risen: Floats = t * t * (3.0 - 2.0 * t)
    return risen


@dataclass(frozen=True, slots=True)
class Field:
    """Self-affine noise of standard deviation 1."""

    values: NDArray[np.float32]
    """(n, n) one period; n is a power of two."""
    step_m: float
    """Distance between values, m."""
    turn: tuple[float, float]
    """Cosine and sine of the angle by which the square is rotated."""

    def at(self, x: Floats, y: Floats) -> Floats:
        """Return bilinear values at positions in metres."""
        last = len(self.values) - 1
        u = (self.turn[0] * x + self.turn[1] * y) / self.step_m
        v = (self.turn[0] * y - self.turn[1] * x) / self.step_m
        i, j = np.floor(u).astype(np.int32), np.floor(v).astype(np.int32)
        right, up = u - i, v - j
        i, j = i & last, j & last
        i_next, j_next = (i + 1) & last, (j + 1) & last
        low = self.values[j, i] * (1 - right) + self.values[j, i_next] * right
        high = self.values[j_next, i] * (1 - right) + self.values[j_next, i_next] * right
        found: Floats = low * (1 - up) + high * up
        return found


def make_field(rng: np.random.Generator, size: int, step_m: float, hurst: float, waves_m: tuple[float, float]) -> Field:
    """Make a field of ``size`` x ``size`` values (a power of two), with waves between two lengths.

    Its power spectral density falls as k^-(2 hurst + 2); natural ground has a Hurst exponent of 0.3 to 0.9.
    """
    k = np.hypot(np.fft.fftfreq(size, step_m)[:, None], np.fft.rfftfreq(size, step_m)[None, :])
    inside = (k >= 1 / waves_m[1]) & (k <= 1 / waves_m[0])
    gain = np.where(inside, np.maximum(k, 1e-9) ** -(hurst + 1), 0.0)
    values = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((size, size))) * gain, s=(size, size))
    angle = rng.uniform(0, 2 * np.pi)
    return Field((values / values.std()).astype(np.float32), step_m, (float(np.cos(angle)), float(np.sin(angle))))
