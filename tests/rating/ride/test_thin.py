"""The rating of thin surveys by the shipped models, against the ground without survey errors."""

from dataclasses import fields, replace

import numpy as np
import pytest

from bumpymap.core.types import NO_CLASS, Reason
from bumpymap.lab.simulate.model import relief_and_slope
from bumpymap.lab.simulate.ride_fit import strengths_of, survey_columns
from bumpymap.lab.terrains import make_terrain
from bumpymap.rating import BlockRating, Calibration, RideModel, rate_thin, roll_over
from bumpymap.rating.ride.thin import THIN_COLUMNS, ThinModel, is_rateable

CALIBRATION = Calibration.shipped("warthog")
RIDE = RideModel(CALIBRATION)
MODEL = ThinModel.from_record(CALIBRATION.thin)
KINDS = ("flat", "low_noise", "noise_sin", "fractal_2", "fractal_5", "fractal_8", "stones", "tufts", "ruts")


@pytest.fixture(scope="module")
def unseen():
    """Terrain that no model was fitted to, and ln of its true C_r."""
    terrains = [make_terrain(kind, 77, index) for kind in KINDS for index in range(12)]
    relief, slope = relief_and_slope([terrain.heights for terrain in terrains], 3.0)
    none = np.zeros(len(terrains))
    truth = RIDE.correction.predict(roll_over(relief, RIDE.operator), slope, none, none + 1e3)
    return terrains, truth.log_c_r


def columns_of(terrains, density, noise):
    columns, tile = survey_columns(terrains, density, noise, 5, RIDE.operator)
    known = is_rateable(columns, np.zeros(len(columns), np.uint8))
    return columns[known], tile[known]


def ranks(values):
    return np.argsort(np.argsort(values))


@pytest.mark.parametrize(("density", "noise", "least"), [(12.0, 0.0, 0.975), (4.0, 0.0, 0.95), (4.0, 0.02, 0.93)])
def test_ranks_and_intervals_of_unseen_ground(unseen, density, noise, least):
    terrains, truth = unseen
    columns, tile = columns_of(terrains, density, noise)
    wanted = truth[tile]
    found = MODEL.predict(columns, strengths_of(columns, wanted))
    assert np.corrcoef(ranks(found.log_c_r), ranks(wanted))[0, 1] >= least
    error = wanted - found.log_c_r
    held = np.mean((error > -1.2816 * found.below) & (error < 1.2816 * found.above))
    assert 0.72 <= held <= 0.93


def test_fewer_points_widen_the_interval(unseen):
    widths, (terrains, truth) = [], unseen
    for density in (2.0, 6.0, 20.0):
        columns, tile = columns_of(terrains, density, 0.01)
        found = MODEL.predict(columns, strengths_of(columns, truth[tile]))
        widths.append(float(np.median(found.below + found.above)))
    assert widths[0] > 1.2 * widths[1] > 1.2 * 1.2 * widths[2]


def first_pass(rows=18, cols=18, reason=Reason.TOO_FEW_POINTS):
    nothing = np.full((rows, cols), np.nan, np.float32)
    unknown = np.full((rows, cols), NO_CLASS, np.uint8)
    return BlockRating(unknown, *(nothing.copy() for _ in range(5)), np.full((rows, cols), reason, np.uint8))


def rated(c_r, low=0.8, high=1.3, p_fail=0.03, reason=Reason.TOO_FEW_POINTS):
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
    first = rated(np.random.default_rng(0).uniform(0.1, 0.2, (18, 18)), 0.5, 2.0, 0.015, Reason.OK)
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
    columns, bare = block_of(unseen), rated(np.full((18, 18), 0.03))
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
    first = replace(rated(np.full((18, 18), 0.06)), c_r_low=low)
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
