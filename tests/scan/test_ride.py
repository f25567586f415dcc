"""The ride of a vehicle on the sectors of a scan: as a survey of the same ground says, or unknown."""

import json
import math
from dataclasses import replace

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from scan_scenes.things import make_field

import bumpymap
from bumpymap.core import NO_CLASS, Scan, UsageError, sector_bounds
from bumpymap.rating import find_calibration
from bumpymap.scan import ScanConfig, polar_sectors, scan_frames
from bumpymap.scan.methods import SectorRater

HIGH_M = 1.7
HALF_M = 21.0


class Ground:
    """Relief that grows northwards from almost none."""

    def __init__(self):
        self.field = make_field(np.random.default_rng(3), 512, 0.05, 0.6, (0.3, 6.0))

    def z(self, x, y):
        return 0.1 * np.clip((y + 15.0) / 30.0, 0.03, 1.0) * self.field.at(x, y) - HIGH_M


def lines_on(ground, steepness):
    """Points where lines of a sensor meet the ground, as if it were even."""
    away = HIGH_M / np.tan(steepness)
    angle = np.linspace(-np.pi, np.pi, 1500, endpoint=False)
    x, y = (np.multiply.outer(away, part).ravel() for part in (np.cos(angle), np.sin(angle)))
    z = ground.z(x, y) + 0.01 * np.random.default_rng(1).standard_normal(len(x))
    return np.column_stack([x, y, z]).astype(np.float32)


@pytest.fixture(scope="module")
def ground():
    return Ground()


@pytest.fixture(scope="module")
def points(ground):
    return lines_on(ground, np.radians(np.linspace(3.0, 50.0, 120)))


@pytest.fixture(scope="module")
def rater():
    return SectorRater(find_calibration("warthog"))


@pytest.fixture(scope="module")
def mapped(ground, tmp_path_factory):
    """C_r by column and row of the tiles of a dense survey."""
    folder = tmp_path_factory.mktemp("survey")
    x, y = np.random.default_rng(2).uniform(-HALF_M, HALF_M, (2, 150_000))
    survey = laspy.LasData(laspy.LasHeader(point_format=0, version="1.2"))
    survey.header.scales = [0.0001] * 3
    survey.x, survey.y, survey.z = x, y, ground.z(x, y)
    survey.write(folder / "survey.las")
    bumpymap.map_survey(folder / "survey.las", folder / "map", vehicle="warthog", local=True)
    tiles = pq.read_table(folder / "map" / "tiles.parquet", columns=["col", "row", "c_r"]).to_pydict()
    return dict(zip(zip(tiles["col"], tiles["row"], strict=True), tiles["c_r"], strict=True))


def test_sectors_say_what_a_survey_of_the_ground_says(points, rater, mapped):
    stack = polar_sectors(Scan(points))
    ride, bounds = rater(Scan(points), stack), sector_bounds(stack)
    found = []
    for number in np.flatnonzero((ride.class_id != NO_CLASS) & (bounds.far < HALF_M - 3.0)):
        share = (np.arange(12) + 0.5) / 12
        away = np.sqrt(bounds.near[number] ** 2 * (1 - share) + bounds.far[number] ** 2 * share)[:, None]
        angle = bounds.right[number] * (1 - share) + bounds.left[number] * share
        places = (np.floor(away * side / 3.0).astype(int).ravel() for side in (np.cos(angle), np.sin(angle)))
        truth = np.mean([mapped[tile] for tile in zip(*places, strict=True)])
        found.append((ride.c_r[number], ride.c_r_low[number], ride.c_r_high[number], truth))
    c_r, low, high, truth = np.array(found).T
    assert len(truth) > 100
    assert truth.max() > 3 * truth.min()
    assert 0.85 < np.median(c_r / truth) < 1.1
    assert np.corrcoef(np.log(c_r), np.log(truth))[0, 1] > 0.9
    assert ((low <= truth) & (truth <= high)).mean() > 0.8
    limits = find_calibration("warthog").class_limits
    known = ride.class_id != NO_CLASS
    assert (ride.class_id[known] >= np.searchsorted(limits, ride.c_r[known], side="right")).all()


class Slope:
    """Smooth ground that rises northwards by 8 degrees."""

    def z(self, _x, y):
        return math.tan(math.radians(8.0)) * y - HIGH_M


@pytest.mark.parametrize(("limit", "classes"), [(5.0, {3}), (30.0, {0})])
def test_smooth_ground_that_is_too_steep_is_of_the_roughest_class(limit, classes):
    calibration = find_calibration("warthog")
    rater = SectorRater(replace(calibration, vehicle=calibration.vehicle | {"slope_limit_deg": limit}))
    scan = Scan(lines_on(Slope(), np.radians(np.linspace(3.0, 50.0, 120))))
    ride = rater(scan, polar_sectors(scan))
    known = ride.class_id != NO_CLASS
    assert known.sum() > 50
    assert set(ride.class_id[known].tolist()) == classes


def test_few_lines_are_no_smooth_ground(ground, rater):
    """Five lines meet every sector of the second zone, and nothing is known of what lies between them."""
    points = lines_on(ground, np.arctan(HIGH_M / np.arange(4.5, 28.0, 2.0)))
    stack = polar_sectors(Scan(points))
    ride = rater(Scan(points), stack)
    assert stack.traversable.sum() > 50
    assert (ride.class_id == NO_CLASS).all()
    assert np.isnan([ride.c_r, ride.c_r_low, ride.c_r_high]).all()


def test_nothing_is_known_where_there_is_no_ground(points, rater):
    scan = Scan(points[:0])
    assert len(rater(scan, polar_sectors(scan)).c_r) == 0
    wall = points[points[:, 0] < 6.0]
    beyond = np.array([[6.0, 0.01 * step, 0.02 * high] for step in range(-200, 200) for high in range(-60, 20)])
    scan = Scan(np.concatenate([wall, beyond.astype(np.float32)]))
    stack = polar_sectors(scan)
    ride = rater(scan, stack)
    assert (ride.class_id[~stack.traversable] == NO_CLASS).all()
    assert (np.isnan(ride.c_r) == (ride.class_id == NO_CLASS)).all()


def test_a_run_writes_what_the_classifier_returns(points, tmp_path):
    np.column_stack([points, np.zeros(len(points))]).astype("<f4").tofile(tmp_path / "a.bin")
    config = ScanConfig(
        (tmp_path / "a.bin",), tmp_path / "out", vehicle="car", products=("table", "polygons"), columns=4
    )
    scan_frames(config)
    result = bumpymap.classify_scan(points, vehicle="car")
    table = pq.read_table(tmp_path / "out" / "sectors.parquet").to_pydict()
    c_r = np.array([math.nan if value is None else value for value in table["c_r"]], np.float32)
    np.testing.assert_array_equal(c_r, result.sector_c_r)
    assert np.isfinite(c_r).any()
    assert [NO_CLASS if value is None else value for value in table["ride_class"]] == result.sector_ride_class.tolist()
    record = json.loads((tmp_path / "out" / "scan.json").read_text())
    calibration = find_calibration("car")
    assert record["calibration"]["id"] == calibration.id
    counts = record["frames"][0]["sectors_by_ride"]
    assert counts["unknown"] == int(np.isnan(c_r[np.array(table["traversable"])]).sum())
    assert result.sectors.sectors.settings.belly_m == calibration.body.lowest_obstacle_m
    assert result.sectors.sectors.settings.height_m == calibration.body.height_m
    features = json.loads((tmp_path / "out" / "frames" / "a.json").read_text())["features"]
    np.testing.assert_allclose(
        [math.nan if each["properties"]["c_r"] is None else each["properties"]["c_r"] for each in features], c_r, 1e-6
    )


def test_settings_that_contradict_the_vehicle():
    with pytest.raises(UsageError, match="leave out belly_m, or the vehicle"):
        bumpymap.ScanClassifier(vehicle="warthog", polar={"belly_m": 0.1})
    with pytest.raises(UsageError, match="contradict"):
        bumpymap.ScanClassifier(vehicle="warthog", calibration="c.json")
    with pytest.raises(UsageError, match="unknown setting wheels"):
        bumpymap.ScanClassifier(wheels=4)
