"""Noise: told from the points, taken off the ground, and ground left alone."""

import numpy as np
import pytest

from bumpymap.core import FeatureSettings, loops
from bumpymap.lab.simulate.ride_fit import survey_terrains
from bumpymap.lab.terrains import Terrain, make_terrain
from bumpymap.patches.features import measure
from bumpymap.rating import RideOperator, Vehicle, denoise, roll_over

OPERATOR = RideOperator.of(Vehicle.load("warthog"), 3.0, 15)
PLANE = Terrain("plane", np.zeros((60, 60)), 3.0)


def surveyed(terrains, density, noise, seed=1):
    """Patches of terrains side by side, in their order."""
    (block,) = survey_terrains(terrains, density, noise, seed).blocks()
    return measure(block, FeatureSettings(), ground_only=False)


def pitch_of(relief):
    return roll_over(relief, OPERATOR).pitch_change


@pytest.mark.parametrize(("density", "noise"), [(25, 0.03), (100, 0.01), (100, 0.03), (1000, 0.05)])
def test_the_noise_of_level_ground_is_told_and_taken_off(density, noise):
    patches = surveyed([PLANE] * 16, density, noise)
    clean, (point, pixel) = denoise(patches)
    assert np.median(point) == pytest.approx(noise, rel=0.08)
    raw, left = np.median(pitch_of(patches.relief_map)), np.median(pitch_of(clean))
    assert left < 0.4 * raw
    if noise <= 0.03 and density >= 100:
        assert left < 0.02  # smooth
    felt = np.median(roll_over(patches.relief_map, OPERATOR).pitch_change_rms)
    assert density < 1000 or np.median(pixel) * OPERATOR.noise_gain == pytest.approx(felt, rel=0.1)


def test_the_noise_of_a_slope_is_that_of_level_ground():
    slope = Terrain("slope", 0.6 * np.linspace(0, 3, 60)[None, :].repeat(60, axis=0), 3.0)
    _, (point, _) = denoise(surveyed([slope] * 16, 25, 0.01))
    assert np.median(point) == pytest.approx(0.01, rel=0.15)
    assert point.min() > 0.004


def test_ground_without_noise_stays_as_it_is():
    terrains = [make_terrain(kind, 3, 1, slope_limit_deg=5) for kind in ("low_noise", "kerb", "stones", "washboard")]
    patches = surveyed(terrains, 1000, 0.0)
    after = pitch_of(denoise(patches)[0])
    assert after == pytest.approx(pitch_of(patches.relief_map), rel=0.03)


def test_a_kerb_survives_noise():
    kerb = Terrain("kerb", np.where(np.arange(60) < 30, 0.0, 0.2)[None, :].repeat(60, axis=0), 3.0)
    truth, noisy = (surveyed([kerb] * 8, *effects) for effects in ((1000, 0.0), (100, 0.03)))
    maps = (truth.relief_map, noisy.relief_map, denoise(noisy)[0])
    wanted, raw, found = (np.median(pitch_of(relief)) for relief in maps)
    assert 0.9 * wanted < found < wanted + 0.8 * (raw - wanted)


def test_noise_that_cannot_be_told_is_not_invented():
    patches = surveyed([PLANE] * 4, 5, 0.03)
    clean, (point, pixel) = denoise(patches)
    unknown = np.isnan(pixel)
    assert np.isnan(point[unknown]).all()
    assert np.array_equal(clean[unknown], patches.relief_map[unknown], True)


def test_a_variance_that_is_no_number_ends_the_search():
    count, variance = np.full((15, 15), 4, np.int32), np.full((15, 15), np.nan, np.float32)
    assert np.isnan(loops.point_noise(count, variance))
