"""The ride model: operators against slow walks and closed forms, correction, noise, thin surveys, other speeds."""

import json
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import grey_dilation, map_coordinates
from scipy.signal import butter, freqs
from scipy.stats import multivariate_normal

from bumpymap.core import NO_CLASS, BadInputError, FeatureSettings, Reason, UsageError, interval_log_sd, loops
from bumpymap.lab.simulate.model import relief_and_slope
from bumpymap.lab.simulate.ride_fit import strengths_of, survey_columns, survey_terrains
from bumpymap.lab.terrains import Terrain, make_terrain
from bumpymap.patches.features import measure
from bumpymap.rating import THIN_COLUMNS, RideOperator, Rides, at_speed, find_strengths, map_rule, move_over, roll_over
from bumpymap.rating.calibration import Calibration, shipped_calibrations
from bumpymap.rating.ride.correction import Correction, Prediction, subtract_noise
from bumpymap.rating.ride.operator import MotionOperator, chassis_response, felt_response, interpolation, weighting_wk
from bumpymap.rating.ride.rate import DRIVE_LOG_SD, RideModel, denoise, interval
from bumpymap.rating.ride.speed import MotionModel, motion_factors, motion_felt, plain_factors, plain_speed_factor
from bumpymap.rating.ride.thin import THIN_RING, WAVE_SUMS, BlockRating, ThinModel, is_rateable, rate_thin, wave_sums
from bumpymap.rating.steps import StepEffect, apply_steps
from bumpymap.rating.textures import TextureModel, classify
from bumpymap.rating.vehicle_profile import Vehicle, less_floor

WARTHOG, CALIBRATION = Vehicle.load("warthog"), Calibration.shipped("warthog")
RIDE, MOTION = RideOperator.of(WARTHOG, 3.0, 15), MotionOperator.of(WARTHOG, 3.0, 15, (0.5, 2.0))
STIFF = replace(WARTHOG, rocker=replace(WARTHOG.rocker, stiffness_nm_per_rad=0.0))
BASE, TRACK = WARTHOG.wheelbase_m, WARTHOG.track_m
HEIGHT_M, SIDE_M, WAVE_PIXELS, SPEED = 0.005, 3.0, 60, 2.0
TABLE = {0: 0, 0.1: 31.2, 0.5: 418, 1: 482, 2: 531, 4: 967, 5: 1039, 6.3: 1054, 8: 1036, 16: 768, 31.5: 405, 80: 132}
"""Frequency [Hz] -> Wk times 1000, of table 3 of ISO 2631-1:1997 (true one-third octave frequencies are near)."""


def patches(seed, count=6, sd=0.1):
    relief = np.random.default_rng(seed).normal(0.0, sd, (count, 15, 15))
    return (relief - relief.mean(axis=(1, 2), keepdims=True)).astype(np.float32)


def envelopes_by_scipy(patch, operator, wheel):
    """Grey dilations of the bilinear nodes, mirrored far on all sides, by cylinders in four directions."""
    grid = interpolation(15, operator.fine)
    nodes = grid @ patch.astype(np.float64) @ grid.T
    step, radius = 3.0 / (15 * operator.fine), wheel.radius_m
    reach = int(radius / step + 1e-9)
    away = np.arange(-reach, reach + 1) * step
    wide, rolled = np.pad(nodes, 3 * len(nodes), mode="reflect"), []
    for turn in (0.0, 45.0, 90.0, 135.0):
        cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        along, beside = away[None, :] * cos + away[:, None] * sin, away[:, None] * cos - away[None, :] * sin
        under = (abs(along) <= radius + 1e-9) & (abs(beside) <= (wheel.width_m + step) / 2 + 1e-9)
        cap = np.sqrt(np.maximum(radius**2 - along**2, 0)) - radius
        rolled.append(grey_dilation(wide, footprint=under, structure=np.where(under, cap, 0.0)))
    return np.array(rolled), step, 3 * len(nodes)


@pytest.mark.parametrize("name", ["warthog", "small_rover"])
def test_pitch_change_is_what_a_slow_walk_over_the_envelope_gives(name):
    """Ridges from south-west to north-east, and some noise."""
    vehicle = Vehicle.load(name)
    operator = RideOperator.of(vehicle, 3.0, 15)
    patch = (patches(1, 1, 0.03)[0] + np.sin(np.add.outer(range(15), range(15)) / 2.0) / 10.0).astype(np.float32)
    envelopes, step, margin = envelopes_by_scipy(patch, operator, vehicle.wheel)
    rng = np.random.default_rng(2)
    x, y, heading = rng.uniform(0, 3, 4000), rng.uniform(0, 3, 4000), rng.uniform(0, 2 * np.pi, 4000)
    taps = chassis_response(vehicle, step / 2)
    turn = np.rint(heading / (np.pi / 4)) % 4

    def pitch(back):
        total = 0.0
        for forward in (1, -1):
            for left in (1, -1):
                along, beside = forward * vehicle.wheelbase_m / 2 - back, left * vehicle.track_m / 2
                east = x + np.cos(heading) * along - np.sin(heading) * beside
                north = y + np.sin(heading) * along + np.cos(heading) * beside
                place = [turn, north / step + margin, east / step + margin]
                total = total + forward * map_coordinates(envelopes, place, order=1)
        return total / (2 * vehicle.wheelbase_m)

    change = sum(tap * (pitch(step / 2 * i) - pitch(step / 2 * (i + 1))) for i, tap in enumerate(taps)) / (step / 2)
    slow = np.abs(change)
    error = slow.std() / np.sqrt(len(slow))
    quick = roll_over(patch[None], operator).pitch_change[0]
    assert quick == pytest.approx(slow.mean(), abs=4 * error + 0.03 * slow.mean())


def test_a_patch_that_is_turned_or_mirrored_has_the_same_ride():
    patch = patches(4, 20)
    whole = roll_over(patch, RIDE).pitch_change
    for other in (np.rot90(patch, 1, (1, 2)), patch[:, :, ::-1]):
        np.testing.assert_allclose(roll_over(other, RIDE).pitch_change, whole, rtol=1e-5)


def test_pitch_at_the_profiles_speed_is_that_of_c_r_to_the_bit():
    relief = patches(3, 20, sd=0.05)
    moved = move_over(relief, MotionOperator.of(WARTHOG, 3.0, 15, (0.5, WARTHOG.speed_mps, 2.0)))
    np.testing.assert_array_equal(moved.pitch_change[:, 1], roll_over(relief, RIDE).pitch_change)


def test_heights_of_a_patch_are_measured():
    many = patches(5, 4)
    rides = roll_over(many, RIDE)
    for patch, span, change in zip(many.astype(np.float64), rides.height_range, rides.height_change, strict=True):
        sizes = [abs(patch[2:] - patch[:-2]).ravel(), abs(patch[:, 2:] - patch[:, :-2]).ravel()]
        assert span == pytest.approx(patch.max() - patch.min())
        assert change == pytest.approx(np.concatenate(sizes).mean(), rel=1e-6)


@pytest.fixture(scope="module")
def fine():
    # A thin wheel, of one node: one of true width rides on its edge where the ground falls to the side.
    return MotionOperator.of(replace(STIFF, wheel=replace(WARTHOG.wheel, width_m=0.005)), SIDE_M, WAVE_PIXELS, (SPEED,))


def waves(wavelength):
    """Cosine waves along x whose mirror images at the patch's edges go on: one patch of them."""
    x = (np.arange(WAVE_PIXELS) + 0.5) * SIDE_M / WAVE_PIXELS
    wave = 0.3 + HEIGHT_M * np.cos(2 * np.pi * x / wavelength)
    return np.ascontiguousarray(np.broadcast_to(wave, (1, WAVE_PIXELS, WAVE_PIXELS)), np.float32)


def every_heading(wavelength):
    """Waves per metre along and across a vehicle, for all headings."""
    heading = (np.arange(20_000) + 0.5) / 20_000 * np.pi / 2
    return np.cos(heading) / wavelength, np.sin(heading) / wavelength


@pytest.mark.parametrize("wavelength", [3.0, 2.0, 1.5])
def test_waves_pitch_and_roll_and_lift_as_the_closed_forms_say(fine, wavelength):
    moved = move_over(waves(wavelength), fine)
    along, across = every_heading(wavelength)
    # The mean of both sides, or their difference over the track, is again a sine; mean absolute slope 4 A per wave.
    pitch = 8 * HEIGHT_M * along * abs(np.sin(np.pi * BASE * along) * np.cos(np.pi * TRACK * across)) / BASE
    roll = 8 * HEIGHT_M * along * abs(np.cos(np.pi * BASE * along) * np.sin(np.pi * TRACK * across)) / TRACK
    lift = HEIGHT_M * np.cos(np.pi * BASE * along) * np.cos(np.pi * TRACK * across) * abs(felt_response(SPEED * along))
    assert moved.pitch_change[0, 0] == pytest.approx(pitch.mean(), rel=0.05)
    assert moved.roll_change[0] == pytest.approx(roll.mean(), rel=0.05)
    assert moved.heave[0, 0] == pytest.approx(np.sqrt((lift**2 / 2).mean()), rel=0.05)


@pytest.mark.parametrize(("frequency", "weight"), TABLE.items())
def test_wk_is_that_of_the_standard(frequency, weight):
    assert 1000 * abs(weighting_wk(np.array([frequency]))[0]) == pytest.approx(weight, rel=0.005)


def test_above_ten_hertz_it_falls_like_a_butterworth_filter_of_fourth_order():
    assert felt_response(np.zeros(1))[0] == 0
    frequency = np.geomspace(0.3, 100, 50)
    _, cut = freqs(*butter(4, 2 * np.pi * 10.0, analog=True), worN=2 * np.pi * frequency)
    felt = felt_response(frequency) / ((2j * np.pi * frequency) ** 2 * weighting_wk(frequency))
    np.testing.assert_allclose(felt, cut, rtol=1e-6)


MODEL = RideModel(CALIBRATION)


def patches_of(*kinds, slope=5.0, density=200.0, index=3):
    terrains = [make_terrain(kind, 9, index, slope_limit_deg=slope) for kind in kinds]
    (block,) = survey_terrains(terrains, density, 0.005, 1).blocks()
    return measure(block, FeatureSettings(), ground_only=False)


def rated(patches, model=MODEL):
    return model.rate(patches, classify(patches, TextureModel.shipped()))


def test_the_numbers_of_a_tile_agree_with_each_other():
    cost = rated(patches_of(*("flat", "low_noise", "tufts", "stones", "fractal_2", "steps", "high_noise")))
    assert np.all((cost.c_r_low < cost.c_r) & (cost.c_r < cost.c_r_high))
    assert np.all((cost.p_fail >= 0) & (cost.p_fail <= 1))
    assert np.all((cost.confidence >= 0) & (cost.confidence <= 1))
    by_c_r = np.searchsorted(CALIBRATION.class_limits, cost.c_r, side="right")
    assert np.array_equal(cost.class_id, np.where(cost.p_fail >= 0.5, 3, by_c_r))


def test_the_interval_holds_80_percent_of_single_drives_and_tells_how_far_off_their_mean_is():
    rng = np.random.default_rng(4)
    log_c_r, below, above = rng.uniform(-5, 0, 40_000), *rng.uniform(0.05, 0.4, (2, 40_000))
    c_r, low, high = interval(Prediction(log_c_r, below, above, np.zeros(40_000)), 0.0)
    error = rng.standard_normal(40_000)
    mean = log_c_r + error * np.where(error < 0, below, above)
    drive = np.exp(mean + DRIVE_LOG_SD * rng.standard_normal(40_000))
    assert np.mean((low < drive) & (drive < high)) == pytest.approx(0.8, abs=0.01)
    np.testing.assert_allclose(interval_log_sd(c_r, low, high, DRIVE_LOG_SD), [below, above], rtol=1e-6)


def test_a_tile_steeper_than_the_vehicle_can_climb_is_class_3():
    patches = patches_of("flat", "flat")
    steep = replace(patches, slope=np.array([5.0, CALIBRATION.vehicle["slope_limit_deg"] + 1]))
    cost = rated(steep)
    assert cost.class_id.tolist()[1] == 3
    assert cost.confidence[1] > 0.9
    assert (cost.p_fail < 0.5).all()  # that of the drives


def test_a_tile_that_cannot_be_judged_has_no_class():
    (block,) = survey_terrains([make_terrain("flat", 1, 1)], 1.0, 0.0, 1).blocks()
    cost = rated(measure(block, FeatureSettings(), ground_only=False))
    assert cost.class_id.tolist() == [NO_CLASS]
    assert np.isnan([cost.c_r[0], cost.c_r_low[0], cost.p_fail[0], cost.confidence[0]]).all()


def test_leaves_over_ground_are_not_taken_for_noise(measure_points):
    rng = np.random.default_rng(2)
    x, y = rng.uniform(0, 3, (2, 900))
    z = np.where(rng.random(900) < 0.5, 0.0, 5.0 + rng.normal(0, 0.3, 900))
    assert rated(measure_points(x, y, z)).class_id.tolist() == [3]


RECORD = CALIBRATION.ride
CORRECTION = Correction.from_record(RECORD)


def rides_of(*values):
    """Rides whose values are all the same on each patch, but for the belly, which touches nothing."""
    same = Rides(*(np.array(values) for _ in fields(Rides)))
    return replace(same, belly_reach=np.zeros(len(values)))


def predicted(rides, excess=0.0, correction=CORRECTION):
    felt = rides.pitch_change * np.sqrt(np.expm1(2 * excess))
    return correction.predict(rides, np.full(len(felt), 5.0), felt, np.full(len(felt), 4.0))


ROUGH = rides_of(*np.geomspace(0.005, 1.5, 50))


def test_below_what_was_driven_c_r_is_proportional():
    found = predicted(rides_of(1e-3, 1e-4))
    assert np.exp(CORRECTION.log_range[0]) > 1e-3
    assert np.diff(found.log_c_r) == pytest.approx(np.log(0.1))


@pytest.mark.parametrize("vehicle", shipped_calibrations())
def test_c_r_of_ground_that_reaches_higher_than_any_that_was_crossed_is_not_made_up(vehicle):
    """In the driven terrains that were crossed the belly reach is 1.4 to 2.3 at most; a square beyond is a guess."""
    correction = Correction.from_record(Calibration.shipped(vehicle).ride)
    c_r = [
        predicted(replace(ROUGH, belly_reach=np.full(50, reach)), correction=correction).log_c_r
        for reach in (0.0, 1.5, 2.0, 5.0)
    ]
    np.testing.assert_array_equal(c_r[1], c_r[2])
    np.testing.assert_array_equal(c_r[1], c_r[3])
    assert np.all(c_r[0] <= c_r[1])
    assert np.all(c_r[1] < c_r[0] + np.log(2.5))


def test_ground_is_not_called_smoother_than_its_noise_lets_one_tell():
    rides = rides_of(1e-5, 1e-3, 0.2)
    found = CORRECTION.predict(rides, np.zeros(3), np.full(3, 0.1), np.full(3, 4.0))
    assert found.log_c_r[0] == found.log_c_r[1] < found.log_c_r[2]
    g, excess = subtract_noise(rides.pitch_change, np.full(3, 0.1))
    assert g == pytest.approx([0.01, 0.01, 0.2])
    assert np.exp(2 * excess) == pytest.approx([101, 101, 1.25])


def test_noise_widens_the_interval():
    quiet, loud, unknown = (predicted(ROUGH, excess) for excess in (0.0, 1.5, np.nan))
    assert np.all(loud.below > quiet.below)
    assert np.all(unknown.below > quiet.below)


MODELS = {"the ride model": (Correction, RECORD), "thin surveys": (ThinModel, CALIBRATION.thin)}
MODELS |= {"record of speeds": (MotionModel, CALIBRATION.motion)}
DAMAGE = {
    "the ride model": [
        *({name: None} for name in ("c_r", "excess")),
        *({"c_r": "text"}, {"noise_low": [[1.0]]}, {"fail": [0.1] * 9}, {"c_r": [0.1] * 7}),
        *({"model_error": wrong} for wrong in (-0.1, float("nan"), float("inf"), "wide")),
    ],
    "thin surveys": [{"c_r": [1.0]}, {"fail": None}, {"sides": [1.0]}],
    "record of speeds": [{"c_r": {}}, {"range": [1.0]}, {"a_w": {"terms": [1.0], "plain": [1.0]}}],
}


@pytest.mark.parametrize("name", MODELS)
def test_a_record_is_read_back_and_a_damaged_one_is_refused_with_what_to_do(name):
    model, record = MODELS[name]
    assert model.from_record(json.loads(json.dumps(model.from_record(record).to_record()))) == model.from_record(record)
    for change in DAMAGE[name]:
        with pytest.raises(BadInputError, match=f"{name}.* is damaged: .*bumpymap calibrate"):
            model.from_record(record | change)
    with pytest.raises(BadInputError, match="9 coefficients of fail, not 10"):
        Correction.from_record(RECORD | {"fail": [0.1] * 9})


def test_what_another_simulation_adds_widens_every_interval():
    own, world = (
        predicted(ROUGH, 0.3, Correction.from_record(RECORD | {"model_error": error})) for error in (0.0, 0.2)
    )
    np.testing.assert_allclose(world.below, np.hypot(own.below, 0.2))
    np.testing.assert_allclose(world.above, np.hypot(own.above, 0.2))
    np.testing.assert_array_equal(world.log_c_r, own.log_c_r)


PLANE = Terrain("plane", np.zeros((60, 60)), 3.0)


def surveyed(terrains, density, noise, seed=1):
    """Patches of terrains side by side, in their order."""
    (block,) = survey_terrains(terrains, density, noise, seed).blocks()
    return measure(block, FeatureSettings(), ground_only=False)


@pytest.mark.parametrize(("density", "noise"), [(25, 0.03), (100, 0.01), (100, 0.03), (1000, 0.05)])
def test_the_noise_of_level_ground_is_told_and_taken_off(density, noise):
    patches = surveyed([PLANE] * 16, density, noise)
    clean, (point, pixel) = denoise(patches)
    assert np.median(point) == pytest.approx(noise, rel=0.08)
    raw, left = np.median(pitch_of(patches.relief_map)), np.median(pitch_of(clean))
    assert left < 0.4 * raw
    if noise <= 0.03 and density >= 100:
        assert left < 0.02  # smooth
    felt = np.median(roll_over(patches.relief_map, RIDE).pitch_change_rms)
    assert density < 1000 or np.median(pixel) * RIDE.noise_gain == pytest.approx(felt, rel=0.1)


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


PIXELS, SIDE = 15, 20
NO_PAIRS = np.zeros((SIDE, SIDE, 2), np.float32)


def cosine_waves():
    """Plane and waves of four half waves and fewer at the pixels, and the power of each; all others are white."""
    place = (np.arange(PIXELS) + 0.5) / PIXELS
    number = {(i, j): np.hypot(i, j) for i in range(15) for j in range(15) if i + j > 0}
    total = sum(k**-3.0 for k in number.values())
    long = {ij: k**-3.0 / total for ij, k in number.items() if k <= 4}
    basis = [
        np.outer(*(np.cos(np.pi * order * place) * (np.sqrt(2) if order else 1) for order in ij)).ravel() for ij in long
    ]
    return np.array(basis).T, np.array(list(long.values()))


def tiles(rng, count, ground, noise, points=36):
    """Reliefs, points and variances of the pixels of made-up tiles: waves of a strength [m] under noise [m]."""
    basis, power = cosine_waves()
    heights = ground * (basis @ (np.sqrt(power)[:, None] * rng.standard_normal((len(power), count)))).T
    heights += ground * np.sqrt(1 - power.sum()) * rng.standard_normal(heights.shape)
    held = rng.multinomial(points, np.full(PIXELS**2, PIXELS**-2.0), count).astype(np.int32)
    mean = heights + noise * rng.standard_normal(heights.shape) / np.sqrt(np.maximum(held, 1))
    variance = np.where(held > 1, noise**2 * rng.chisquare(np.maximum(held - 1, 1)) / np.maximum(held, 1), 0.0)
    shape = (count, PIXELS, PIXELS)
    return mean.reshape(shape).astype("f4"), held.reshape(shape), variance.reshape(shape).astype("f4")


def square(ground, noise, seed=1, points=36):
    sums = wave_sums(*tiles(np.random.default_rng(seed), SIDE**2, ground, noise, points))
    return sums.reshape(SIDE, SIDE, WAVE_SUMS)


@pytest.mark.parametrize("points", [18, 36, 90, 225])
@pytest.mark.parametrize("ground", [0.01, 0.05])
def test_noise_and_ground_are_distinguished_at_any_number_of_points(points, ground):
    around, _ = find_strengths(square(ground, 0.02, points=points), NO_PAIRS)
    assert np.exp(np.median(around.ground)) == pytest.approx(ground, rel=0.3)
    assert np.exp(np.median(around.noise)) == pytest.approx(0.02, rel=0.15 if ground < 0.02 else 0.5)


def test_neighbours_say_what_a_tile_cannot():
    around, alone = find_strengths(square(0.01, 0.02), NO_PAIRS)
    inner = np.s_[5:-5, 5:-5]
    truth = np.log(0.01)
    assert np.std(around.ground[inner]) < 0.8 * np.std(alone.ground[inner])
    assert np.sqrt(np.mean((around.ground[inner] - truth) ** 2)) < 0.4
    assert (around.ground_sd < alone.ground_sd)[inner].mean() > 0.8


def test_what_close_pairs_share_is_ground():
    """Short waves and noise are alike far apart: pairs of points close together differ by the noise alone."""
    sums, pairs = square(0.01, 0.02), np.zeros((SIDE, SIDE, 2), np.float32)
    pairs[..., 1], pairs[..., 0] = 40, 40 * 2 * 0.008**2
    apart, together = (find_strengths(sums, each)[0] for each in (NO_PAIRS, pairs))
    assert np.exp(np.median(together.noise)) == pytest.approx(0.008, rel=0.4)
    assert np.median(together.ground) > np.median(apart.ground) + 0.5


def test_a_rough_tile_stays_rough_among_smooth_ones():
    sums = square(0.01, 0.01)
    sums[10, 10] = wave_sums(*tiles(np.random.default_rng(5), 1, 0.15, 0.01))[0]
    around, alone = find_strengths(sums, NO_PAIRS)
    assert around.ground[10, 10] > alone.ground[10, 10] - 0.15
    assert around.ground[10, 10] > np.median(around.ground) + 1.5


def test_tiles_beyond_the_ring_have_no_part():
    sums = square(0.02, 0.02)
    other = sums.copy()
    far = np.ones((SIDE, SIDE), np.bool_)
    far[10 - THIN_RING : 11 + THIN_RING, 10 - THIN_RING : 11 + THIN_RING] = False
    other[far] = np.nan
    for found, again in zip(find_strengths(sums, NO_PAIRS), find_strengths(other, NO_PAIRS), strict=True):
        assert [values[10, 10] for values in found] == [values[10, 10] for values in again]


def test_a_tile_without_a_plane_is_unknown():
    relief, held, variance = tiles(np.random.default_rng(3), 3, 0.05, 0.02)
    held[0] = 0
    held[1], held[1, 4, :4] = 0, 2  # on a line
    relief[2] = np.nan
    sums = wave_sums(relief, held, variance)
    assert np.isnan(sums).all()
    assert all(np.isnan(values).all() for each in find_strengths(sums[None], NO_PAIRS[:1, :3]) for values in each)


def test_the_likelihood_is_that_of_normal_heights():
    """Up to a constant; the plane of the tile counts as known to nobody."""
    rng, (basis, power) = np.random.default_rng(2), cosine_waves()
    relief, held, _ = tiles(rng, 1, 0.05, 0.02)
    held = np.minimum(held, 1)
    sums = wave_sums(relief, held, np.zeros_like(relief))
    grounds, noises = np.array([0.01, 0.05, 0.2]), np.array([0.01, 0.03])
    found = np.empty((1, 2, 3), np.float32)
    loops.weigh_strengths(sums, noises, grounds, 1.0 - power.sum(), found)
    seen = held.ravel() > 0
    z, waves = relief.ravel()[seen].astype(float), basis[seen]
    row, col = np.divmod(np.flatnonzero(seen), PIXELS)
    plane = np.column_stack((np.ones(len(z)), row, col)) / PIXELS
    rest = np.linalg.svd(plane)[0][:, 3:]  # contrasts that no plane changes
    wanted = np.empty((2, 3))
    for (s, noise), (a, ground) in ((n, g) for n in enumerate(noises) for g in enumerate(grounds)):
        white = noise**2 + (1.0 - power.sum()) * ground**2
        covariance = ground**2 * (waves * power) @ waves.T + white * np.eye(len(z))
        wanted[s, a] = multivariate_normal.logpdf(rest.T @ z, cov=rest.T @ covariance @ rest)
    np.testing.assert_allclose(found[0] - found[0, 0, 0], wanted - wanted[0, 0], rtol=1e-3, atol=2e-3)


THIN = ThinModel.from_record(CALIBRATION.thin)
KINDS = ("flat", "low_noise", "noise_sin", "fractal_2", "fractal_5", "fractal_8", "stones", "tufts", "ruts")


@pytest.fixture(scope="module")
def unseen():
    """Terrain that no model was fitted to, and ln of its true C_r."""
    terrains = [make_terrain(kind, 77, index) for kind in KINDS for index in range(12)]
    relief, slope = relief_and_slope([terrain.heights for terrain in terrains], 3.0)
    none = np.zeros(len(terrains))
    truth = MODEL.correction.predict(roll_over(relief, MODEL.operator), slope, none, none + 1e3)
    return terrains, truth.log_c_r


def columns_of(terrains, density, noise):
    columns, tile = survey_columns(terrains, density, noise, 5, MODEL.operator)
    known = is_rateable(columns, np.zeros(len(columns), np.uint8))
    return columns[known], tile[known]


def ranks(values):
    return np.argsort(np.argsort(values))


@pytest.mark.parametrize(("density", "noise", "least"), [(12.0, 0.0, 0.975), (4.0, 0.0, 0.95), (4.0, 0.02, 0.93)])
def test_ranks_and_intervals_of_unseen_ground(unseen, density, noise, least):
    terrains, truth = unseen
    columns, tile = columns_of(terrains, density, noise)
    wanted = truth[tile]
    found = THIN.predict(columns, strengths_of(columns, wanted))
    assert np.corrcoef(ranks(found.log_c_r), ranks(wanted))[0, 1] >= least
    error = wanted - found.log_c_r
    held = np.mean((error > -1.2816 * found.below) & (error < 1.2816 * found.above))
    assert 0.72 <= held <= 0.93


def test_fewer_points_widen_the_interval(unseen):
    widths, (terrains, truth) = [], unseen
    for density in (2.0, 6.0, 20.0):
        columns, tile = columns_of(terrains, density, 0.01)
        found = THIN.predict(columns, strengths_of(columns, truth[tile]))
        widths.append(float(np.median(found.below + found.above)))
    assert widths[0] > 1.2 * widths[1] > 1.2 * 1.2 * widths[2]


def first_pass(rows=18, cols=18, reason=Reason.TOO_FEW_POINTS):
    nothing = np.full((rows, cols), np.nan, np.float32)
    unknown = np.full((rows, cols), NO_CLASS, np.uint8)
    return BlockRating(unknown, *(nothing.copy() for _ in range(5)), np.full((rows, cols), reason, np.uint8))


def first_rated(c_r, low=0.8, high=1.3, p_fail=0.03, reason=Reason.TOO_FEW_POINTS):
    """A first pass of smooth tiles; the ends of the interval as shares of C_r."""
    columns = {"c_r": c_r, "c_r_low": low * c_r, "c_r_high": high * c_r, "p_fail": 0 * c_r + p_fail, "confidence": c_r}
    columns = {name: np.asarray(values, np.float32) for name, values in columns.items()}
    return replace(first_pass(reason=reason), class_id=np.zeros((18, 18), np.uint8), **columns)


def block_of(unseen, density=4.0):
    columns, _ = columns_of(unseen[0], density, 0.01)
    return np.resize(columns, (18, 18, len(THIN_COLUMNS))).astype(np.float32)


def maps(coverage=0.15, slope=3.0):
    return np.full((18, 18), coverage), np.full((18, 18), slope)


def test_thin_tiles_get_a_class_and_those_of_which_too_little_is_known_stay_unknown(unseen):
    columns = block_of(unseen)
    columns[5, 5, 0] = 3
    columns[6, 6, :2] = 11, 0.0  # a quarter without points, which is chance among ten
    columns[9, 9, :2] = 10, 0.0
    columns[7, 7] = np.nan
    first = first_pass()
    first.reason[8, 8] = Reason.OUTLIER_RELIEF
    found = rate_thin(columns, first, *maps(), CALIBRATION)
    lost = [(4, 4), (5, 5), (6, 6), (7, 7)]
    known = np.ones((16, 16), np.bool_)
    known[tuple(zip(*lost, strict=True))] = False
    assert (found.class_id[known] != NO_CLASS).all()
    assert (found.reason[known] == Reason.OK).all()
    assert (found.class_id[~known] == NO_CLASS).all()
    assert np.isnan(found.c_r[~known]).all()
    assert (found.c_r_low < found.c_r)[known].all()
    assert (found.c_r < found.c_r_high)[known].all()
    assert found.reason[7, 7] == Reason.OUTLIER_RELIEF


def test_dense_tiles_keep_their_bits_and_the_mixture_is_continuous(unseen):
    columns = block_of(unseen, 12.0)
    columns[..., THIN_COLUMNS.index("slope")] = 0.05
    first = first_rated(np.random.default_rng(0).uniform(0.1, 0.2, (18, 18)), 0.5, 2.0, 0.015, Reason.OK)
    dense = rate_thin(columns, first, *maps(coverage=0.75), CALIBRATION)
    for field in fields(BlockRating):
        np.testing.assert_array_equal(getattr(dense, field.name), getattr(first.inner(), field.name))
    nearly = rate_thin(columns, first, *maps(coverage=0.7499), CALIBRATION)
    np.testing.assert_allclose(nearly.c_r, dense.c_r, rtol=2e-3)
    np.testing.assert_allclose(nearly.p_fail, dense.p_fail, atol=1e-3)


@pytest.mark.parametrize("coverage", [0.15, 0.6])
def test_a_floor_is_added_once(unseen, coverage):
    """Also where a tile is rated half from its heightmap, whose C_r holds the floor already."""
    raised = replace(CALIBRATION, vehicle=CALIBRATION.vehicle | {"floor": {"c_r_radpm": 0.05}})
    columns, bare = block_of(unseen), first_rated(np.full((18, 18), 0.03))
    names = ("c_r", "c_r_low", "c_r_high")
    first = replace(bare, **{name: np.hypot(getattr(bare, name), np.float32(0.05)) for name in names})
    found = rate_thin(columns, bare, *maps(coverage=coverage), CALIBRATION)
    with_it = rate_thin(columns, first, *maps(coverage=coverage), raised)
    np.testing.assert_array_equal(with_it.class_id, found.class_id)
    for name in names:
        np.testing.assert_allclose(getattr(with_it, name), np.hypot(getattr(found, name), 0.05), rtol=1e-4)


def test_a_low_end_that_is_lost_in_the_floor_keeps_no_tile_from_its_points(unseen):
    """Stored as float32, an end far below the floor is the floor itself."""
    floor = np.float32(0.05)
    raised = replace(CALIBRATION, vehicle=CALIBRATION.vehicle | {"floor": {"c_r_radpm": float(floor)}})
    low = np.where(np.arange(18) % 2 == 0, floor, np.float32(0.055)) + np.zeros((18, 18), np.float32)
    first = replace(first_rated(np.full((18, 18), 0.06)), c_r_low=low)
    found = rate_thin(block_of(unseen), first, *maps(coverage=0.6), raised)
    assert (found.c_r != first.c_r[1:-1, 1:-1]).all()
    assert (found.c_r_low <= found.c_r).all()
    assert (found.c_r <= found.c_r_high).all()
    assert np.isfinite(found.c_r_high).all()


def test_too_steep_ground_is_not_passable(unseen):
    found = rate_thin(block_of(unseen), first_pass(), *maps(slope=31.0), CALIBRATION)
    assert (found.class_id == 3).all()
    columns = block_of(unseen)
    columns[..., THIN_COLUMNS.index("slope")] = 1.0  # 45 degrees, which the heightmap does not show
    found = rate_thin(columns, first_pass(), *maps(slope=3.0), CALIBRATION)
    assert (found.p_fail == 1).all()
    assert (found.class_id == 3).all()


SPEEDS = (0.5, 1.0, 2.0)


@pytest.fixture(scope="module")
def heights():
    rng = np.random.default_rng(8)
    return (rng.normal(0, 1, (30, 15, 15)) * np.geomspace(0.003, 0.15, 30)[:, None, None]).astype(np.float32)


@cache
def rating_at(speed):
    calibration = at_speed(CALIBRATION, speed)
    every = tuple(dict.fromkeys((*SPEEDS, calibration.map_speed)))
    return calibration, MotionOperator.of(CALIBRATION.profile, 3.0, 15, every)


def factors_at(speed, heights):
    calibration, operator = rating_at(speed)
    own, factors = motion_factors(calibration, operator.speeds, move_over(heights, operator), pitch_of(heights))
    return own, factors[:, : 2 * len(SPEEDS)]


def pitch_of(heights):
    return roll_over(heights, RIDE).pitch_change


def test_its_own_speed_changes_nothing_and_another_has_another_id_and_the_same_drives():
    assert at_speed(CALIBRATION, None) is at_speed(CALIBRATION, 1.0) is CALIBRATION
    assert CALIBRATION.map_speed == 1.0
    fast = at_speed(CALIBRATION, 2.0)
    assert fast.id != CALIBRATION.id
    assert (fast.map_speed, fast.vehicle, fast.cost_rule) == (2.0, CALIBRATION.vehicle, CALIBRATION.cost_rule)
    assert Calibration.from_json(fast.to_json(), "file").id == fast.id


def test_speeds_out_of_range_say_what_to_do():
    for speed in (0.39, 2.51):
        with pytest.raises(UsageError, match=r"holds from 0\.4 to 2\.5 m/s"):
            at_speed(CALIBRATION, speed)


def test_at_the_speed_of_the_map_the_factor_is_one_and_c_r_at_a_speed_does_not_depend_on_it(heights):
    (logs, one), (to_fast, other) = (factors_at(speed, heights) for speed in (1.0, 2.0))
    for factors, own in ((one, 1), (other, 2)):
        np.testing.assert_array_equal(factors[:, 2 * own], np.float32(1.0))
    assert (logs == 0).all()
    np.testing.assert_allclose(other * np.exp(to_fast)[:, None], one, rtol=1e-5)


def test_faster_shakes_more_and_tiles_without_a_heightmap_get_a_like_answer(heights):
    _, factors = factors_at(1.0, heights)
    plain = plain_factors(CALIBRATION, SPEEDS, pitch_of(heights))
    for each in (factors, plain):
        assert (np.diff(each.reshape(len(heights), 3, 2)[:, :, 1], axis=1) > 0).all()
    # White noise is rougher at short waves than the ground that both were fitted to.
    assert np.median(np.abs(np.log(plain / factors))) < 0.5
    np.testing.assert_array_equal(plain[:, 2], np.float32(1.0))
    assert np.isnan(plain_factors(CALIBRATION, SPEEDS, np.array([np.nan]))[0]).any()


@pytest.mark.parametrize("name", ["warthog", "car", "husky"])
@pytest.mark.parametrize("comfort", [{}, {"a_w_mps2": 0.8, "top_speed_mps": 9.0}, {"pitch_rate_radps": 0.15}])
def test_ground_is_driven_as_fast_as_the_limits_let_it(name, comfort):
    shipped = Calibration.shipped(name)
    calibration = replace(shipped, vehicle=shipped.vehicle | {"comfort": comfort})
    own, limits, rule = shipped.map_speed, {"pitch_rate_radps": 0.3} | comfort, map_rule(calibration)
    assert rule.top_mps == pytest.approx(min(comfort.get("top_speed_mps", own), 2.5 * own), rel=1e-5)
    speeds = []
    for c_r in np.hypot(np.geomspace(1e-3, 3.0, 60), shipped.floor):
        speed = float(1.0 / rule.slowness(c_r))
        known = max(speed, 0.4 * own)
        told = motion_felt(calibration, (known,), np.full((1, 2), np.nan, np.float32), np.array([c_r], np.float32))[0]
        used = np.hypot(less_floor(told[0], shipped.floor_at(known)) * speed, shipped.floor * own)
        used = max(used / limits["pitch_rate_radps"], told[1] * speed / known / limits.get("a_w_mps2", np.inf))
        assert used <= 1.01
        assert used >= 0.98 or speed == pytest.approx(rule.top_mps)
        speeds.append(speed)
    assert speeds[-1] < 0.4 * own < speeds[0] == pytest.approx(rule.top_mps)
    assert (np.diff(speeds) <= 1e-12).all()


def test_steps_follow_the_speed_of_the_map():
    columns = {
        "class_id": np.zeros(3, np.uint8),
        "coverage": np.ones(3),
        **{name: np.full(3, 0.01, np.float32) for name in ("c_r", "c_r_low", "c_r_high", "p_fail", "confidence")},
    }
    step = np.array([0.1, 0.2, 0.0])
    slow, fast = (apply_steps(columns, step, each) for each in (CALIBRATION, at_speed(CALIBRATION, 2.0)))
    effect = StepEffect.of(CALIBRATION)
    told = effect.read(effect.c_r, step[:2])
    ratio = np.exp(plain_speed_factor(at_speed(CALIBRATION, 2.0), np.log(told)))
    assert slow["c_r"][:2] == pytest.approx(told, rel=1e-5)
    assert fast["c_r"][:2] == pytest.approx(told * ratio, rel=0.03)  # curves are straight between known heights
    np.testing.assert_array_equal(slow["p_fail"], fast["p_fail"])


def test_a_floor_is_a_rate_in_time():
    """Taken off before a ride is scaled to another speed, added after it; acceleration has none."""
    husky = Calibration.shipped("husky")
    own = husky.map_speed
    fast = at_speed(husky, 2 * own)
    assert fast.map_floor == pytest.approx(husky.floor / 2)
    factors = np.array([[2.0, 4.0]], np.float32)
    for calibration in (husky, fast):
        c_r = np.array([np.hypot(0.05, calibration.map_floor)], np.float32)
        (found,) = motion_felt(calibration, (2 * own,), factors, c_r)
        np.testing.assert_allclose(found, [np.hypot(2 * 0.05, husky.floor / 2), 4 * 0.05], rtol=1e-5)
    (level,) = motion_felt(husky, (2 * own,), factors, np.array([husky.floor], np.float32))
    np.testing.assert_allclose(level, [husky.floor / 2, 0.0], atol=1e-4)
