"""The frequency weighting Wk of ISO 2631-1: how much vertical acceleration of a frequency is felt by a seated person.

It is cut at 10 Hz: what shakes a vehicle faster comes from tyres, drive train and ground finer than a heightmap, and in
the simulation from the facets of its ground.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["WEIGHTED_BAND_HZ", "felt_response", "weighting_wk"]

WEIGHTED_BAND_HZ = (0.4, 10.0)
"""Vertical motion of these frequencies counts, Hz."""
_LIMITS_HZ = (0.4, 100.0)
_VELOCITY_HZ, _VELOCITY_Q = 12.5, 0.63
"""Above this frequency the weight falls: velocity is felt rather than acceleration."""
_STEP_HZ, _STEP_Q = (2.37, 3.35), 0.91
"""Between these frequencies the weight rises."""
_CUT_Q = (0.5411961, 1.3065630)
"""Of the two parts of a Butterworth low pass of fourth order."""


def weighting_wk(frequency: NDArray[np.floating]) -> NDArray[np.complex128]:
    """Return the response of Wk at frequencies [Hz] of any shape, with its phase; 0 at 0 Hz.

    The product of a high pass, a low pass, the acceleration to velocity transition and the upward step, with the
    constants of ISO 2631-1:1997, annex A.
    """
    p: NDArray[Any] = 2j * np.pi * frequency
    low, high = (2 * np.pi * corner for corner in _LIMITS_HZ)
    velocity, (first, second) = 2 * np.pi * _VELOCITY_HZ, (2 * np.pi * corner for corner in _STEP_HZ)
    high_pass = p**2 / (p**2 + np.sqrt(2) * low * p + low**2)
    low_pass = 1 / _second_order(p / high, np.sqrt(0.5))
    transition = (1 + p / velocity) / _second_order(p / velocity, _VELOCITY_Q)
    step = _second_order(p / first, _STEP_Q) / _second_order(p / second, _STEP_Q) * (first / second) ** 2
    response: NDArray[np.complex128] = high_pass * low_pass * transition * step
    return response


def felt_response(frequency: NDArray[np.floating]) -> NDArray[np.complex128]:
    """Return the weighted acceleration [m/s2] for a vertical motion of 1 m at frequencies [Hz], up to 10 Hz."""
    p: NDArray[Any] = 1j * frequency / WEIGHTED_BAND_HZ[1]
    cut = _second_order(p, _CUT_Q[0]) * _second_order(p, _CUT_Q[1])
    response: NDArray[np.complex128] = (2j * np.pi * frequency) ** 2 * weighting_wk(frequency) / cut
    return response


def _second_order(p: NDArray[Any], quality: float) -> NDArray[Any]:
    section: NDArray[Any] = 1 + p / quality + p**2
    return section
