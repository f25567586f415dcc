"""Wk against the table of the standard, and the cut at 10 Hz against scipy's Butterworth filter."""

import numpy as np
import pytest
from scipy.signal import butter, freqs

from bumpymap.rating import felt_response
from bumpymap.rating.ride.motion_operator import weighting_wk

TABLE = {0.1: 31.2, 0.5: 418, 1: 482, 2: 531, 4: 967, 5: 1039, 6.3: 1054, 8: 1036, 16: 768, 31.5: 405, 63: 186, 80: 132}
"""Frequency [Hz] -> Wk times 1000, of table 3 of ISO 2631-1:1997 (true one-third octave frequencies are near)."""


@pytest.mark.parametrize(("frequency", "weight"), TABLE.items())
def test_wk_is_that_of_the_standard(frequency, weight):
    assert 1000 * abs(weighting_wk(np.array([frequency]))[0]) == pytest.approx(weight, rel=0.005)


def test_nothing_is_felt_of_a_level_road():
    assert weighting_wk(np.zeros(1))[0] == 0
    assert felt_response(np.zeros(1))[0] == 0


def test_above_ten_hertz_it_falls_like_a_butterworth_filter_of_fourth_order():
    frequency = np.geomspace(0.3, 100, 50)
    _, cut = freqs(*butter(4, 2 * np.pi * 10.0, analog=True), worN=2 * np.pi * frequency)
    felt = felt_response(frequency) / ((2j * np.pi * frequency) ** 2 * weighting_wk(frequency))
    np.testing.assert_allclose(felt, cut, rtol=1e-6)
