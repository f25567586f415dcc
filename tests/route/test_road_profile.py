"""Figures of road practice: published coefficients, closed forms, profiles of known spectrum, marks of noise."""

import numpy as np
import pytest

from bumpymap.core import UsageError
from bumpymap.route.road_profile import iso_8608, quarter_car, road_figures

SPACING = 0.05
STATE = np.array(
    [
        [0.9966071, 0.01091514, -0.002083274, 0.0003190145],
        [-0.5563044, 0.9438768, -0.8324718, 0.05064701],
        [0.02153176, 0.002126763, 0.7508714, 0.008221888],
        [3.335013, 0.3376467, -39.12762, 0.4347564],
    ]
)
"""World Bank Technical Paper 46, for heights 0.25 m apart; so are the coefficients of the profile's slope."""
PROFILE = np.array([0.005476107, 1.388776, 0.2275968, 35.79262])


def made_profile(power, length, seed, spacing=SPACING):
    """Make heights whose power at 0.1 cycles per metre is given, and falls with the square from 0.011 to 2.83."""
    count = round(length / spacing)
    wave = np.fft.rfftfreq(count, spacing)
    inside = (wave >= 0.011) & (wave <= 2.83)
    shape = np.where(inside, np.sqrt(power * count / 2 / spacing) * 0.1 / np.maximum(wave, 1e-9), 0.0)
    return np.fft.irfft(shape * np.exp(2j * np.pi * np.random.default_rng(seed).random(len(wave))), count)


def test_the_quarter_car_is_that_of_the_published_coefficients():
    heights = 0.1 * np.arange(400) * 0.25 + made_profile(64e-6, 100, 1, 0.25)
    slope = np.diff(heights) / 0.25
    begin = (heights[44] - heights[0]) / 11.0
    state, moved = np.array([begin, 0.0, begin, 0.0]), [0.0]
    for value in slope:
        state = STATE @ state + PROFILE * value
        moved.append(1000 * abs(state[0] - state[2]))
    assert np.allclose(quarter_car(heights, 0.25), moved, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("wave_m", [2.0, 5.0, 15.0, 30.0])
def test_iri_of_a_sine_is_the_response_of_its_frequency(wave_m):
    heights = 0.01 * np.sin(2 * np.pi * np.arange(0, 2000, SPACING) / wave_m)
    turn = 2j * np.pi * (80 / 3.6) / wave_m
    wheel = np.array(
        [[turn**2 + 6 * turn + 63.3, -6 * turn - 63.3], [-6 * turn - 63.3, 0.15 * turn**2 + 6 * turn + 716.3]]
    )
    body, tyre = np.linalg.solve(wheel, [0, 653])
    expected = 1000 * 2 / np.pi * 0.01 * 2 * np.pi / wave_m * abs(body - tyre)
    assert quarter_car(heights, SPACING)[10000:].mean() == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(
    ("power", "name"), [(16e-6, "A"), (64e-6, "B"), (256e-6, "C"), (1024e-6, "D"), (65536e-6, "G")]
)
def test_power_class_and_iri_of_made_up_spectra(power, name):
    profile = made_profile(power, 2000, 3)
    assert iso_8608(profile, SPACING)[0] == pytest.approx(power, rel=0.1)
    found = road_figures(np.stack([profile, profile]), SPACING, 1.1, 500.0)
    assert {part.iso_class for part in found} == {name}
    assert len(found) == 4
    assert {part.resolution for part in found} == {"resolved"}
    # Known of such spectra: IRI is 2.21 times the root of the power at 1 rad/m, in cm3 (Kropac and Mucka).
    assert np.mean([part.iri for part in found]) == pytest.approx(2.21 * np.sqrt(power / 16e-6), rel=0.05)


def test_noise_of_larger_pixels_is_marked_too():
    smooth, at = made_profile(16e-6, 400, 1, 0.4), np.arange(0, 399, 0.1) / 0.4
    for noise, mark in ((0.0, "resolved"), (0.03, "not resolvable")):
        pixels = smooth + np.random.default_rng(2).normal(0, noise, smooth.shape)
        heights = np.stack([np.interp(at, np.arange(len(pixels)), pixels)] * 2)
        assert road_figures(heights, 0.1, 1.5, 100.0, 0.4)[0].resolution == mark


def test_noise_is_marked_and_holes_are_unknown():
    smooth = np.stack([made_profile(64e-6, 400, seed, 0.2) for seed in (1, 2)])
    smooth[1] -= 0.03
    noise = np.random.default_rng(4).normal(0, 1, smooth.shape)
    marks = [road_figures(smooth + sd * noise, 0.2, 1.5, 100.0)[0].resolution for sd in (1e-5, 1e-3, 1e-2)]
    assert marks == ["resolved", "limited by noise", "not resolvable"]
    smooth[0, 600:700] = np.nan
    first, holed, *_ = road_figures(smooth, 0.2, 1.5, 100.0)
    assert first.crossfall == pytest.approx(0.02, abs=2e-3)
    assert np.isfinite(first.iri)
    assert (holed.resolution, holed.iso_class) == ("unknown", "")
    assert np.isnan([holed.iri, holed.grade]).all()
    short = road_figures(smooth, 0.2, 1.5, 20.0)[0]
    assert (short.iso_class, np.isfinite(short.iri)) == ("", True)
    with pytest.raises(UsageError, match="10 m or more"):
        road_figures(smooth, 0.2, 1.5, 5.0)
