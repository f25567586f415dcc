"""Random signals of a stated spectrum."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, sosfiltfilt, sosfreqz

__all__ = ["band_noise", "slow_noise"]

Floats = NDArray[np.float64]
_SAMPLES = 4096
"""Frequencies at which the gain of a filter is averaged."""


def band_noise(
    rng: np.random.Generator, shape: tuple[int, int], band_hz: tuple[float, float], rate_hz: float
) -> Floats:
    """Draw Gaussian noise (n, k) of unit variance between two frequencies; columns are independent."""
    sos = butter(2, band_hz, "bandpass", fs=rate_hz, output="sos")
    _, gain = sosfreqz(sos, _SAMPLES)
    # Filtered forwards and backwards: the gain counts twice.
    power = float(np.mean(np.abs(gain) ** 4))
    return np.asarray(sosfiltfilt(sos, rng.standard_normal(shape), axis=0) / np.sqrt(power))


def slow_noise(rng: np.random.Generator, shape: tuple[int, int], forget_s: float, rate_hz: float) -> Floats:
    """Draw first-order Gauss-Markov noise (n, k) of unit variance, whose correlation falls to 1/e in ``forget_s``."""
    keep = float(np.exp(-1 / (forget_s * rate_hz)))
    drawn = rng.standard_normal(shape)
    drawn[1:] *= np.sqrt(1 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], drawn, axis=0))
