"""Classes of sectors by network, stripes and ride; frames of a drive: merges, poses that cannot be right, motion."""

import copy
import json
import math
import re
import sys
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.resources import files

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from made_drives import write_bin
from numpy.testing import assert_array_equal
from point_files import read_vertices, write_ply
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

import bumpymap
from bumpymap import ScanClassifier
from bumpymap.core import NO_CLASS, BadInputError, GridSettings, Robot, Scan, UsageError
from bumpymap.core.scan_types import NOT_TRAVERSABLE, cell_numbers, sector_bounds
from bumpymap.lab.terrains import fractal
from bumpymap.layers import open_accumulated
from bumpymap.rating import find_calibration
from bumpymap.scan import ScanConfig, classify_filter, load_stripes, polar_sectors, scan_frames
from bumpymap.scan.cells import see_cells
from bumpymap.scan.classifier import SectorRater
from bumpymap.scan.learned import ScanModel, classify_learned, infer, neighbours, network_input, probabilities
from bumpymap.scan.merge import MOST_GROUND, MOST_OTHERS, DriveMerge, place_points
from bumpymap.scan.stripes import StripeFilter, count_stripes


def _world(seed=1, count=60_000):
    """Smooth ground ahead, heaps to the left, a thicket behind; (n, 3)."""
    rng = np.random.default_rng(seed)
    away, turn = rng.uniform(4, 27, count), rng.uniform(-np.pi, np.pi, count)
    x, y = away * np.cos(turn), away * np.sin(turn)
    z = -1.4 + rng.normal(0, 0.008, count)
    heaps = (y > 3) & (x > -8)
    blocks = rng.uniform(0, 0.8, (100, 100))  # 30 cm wide, up to 80 cm high
    z[heaps] += blocks[(x[heaps] / 0.3).astype(int) % 100, (y[heaps] / 0.3).astype(int) % 100]
    thicket = x < -8
    z[thicket] += rng.uniform(0, 3, thicket.sum())
    return np.column_stack([x, y, z]).astype(np.float32)


@pytest.fixture(scope="module")
def stack():
    return polar_sectors(Scan(_world()))


@pytest.fixture(scope="module")
def model():
    return ScanModel.shipped()


def test_smooth_ground_is_class_0_and_rough_ground_is_not(stack, model):
    classed = classify_learned(stack, model)
    middle = np.array([stack.point_sector == row for row in range(len(stack.zone))]) @ _world() / stack.count[:, None]
    smooth = (middle[:, 0] > 2) & (middle[:, 1] < -1)
    heaps = (middle[:, 0] > -5) & (middle[:, 1] > 6)
    thicket = middle[:, 0] < -11
    assert (classed.class_id[smooth] == 0).mean() > 0.95
    assert (classed.class_id[heaps] == 0).mean() < 0.1
    assert (classed.class_id[thicket] > 0).all()


def test_open_sectors_share_smooth_or_fair_with_their_neighbours_and_nothing_else(stack, model):
    alone = probabilities(stack, model)
    classed = classify_learned(stack, model)
    assert ((classed.class_id == NOT_TRAVERSABLE) == ~stack.traversable).all()
    is_open = stack.traversable & (stack.ground_count >= 0.55 * stack.count)
    assert 0 < is_open.sum() < stack.traversable.sum()
    covered = stack.traversable & ~is_open
    assert_array_equal(classed.class_id[covered], alone[covered].argmax(axis=1))
    rough = stack.traversable & (alone[:, 2] > 0.5)
    assert (classed.class_id[rough] == 2).all()
    # Log-odds of fair against smooth: its own, and one and a half times the mean of the open sectors around it.
    near, cell = neighbours(stack.settings), cell_numbers(stack)
    smooth, fair = np.maximum(alone[:, :2], 1e-3).T
    odds = dict(zip(cell[is_open].tolist(), np.log(fair / smooth)[is_open].tolist(), strict=True))
    for row in np.flatnonzero(is_open):
        beside = [odds[other] for other in near[cell[row]].tolist() if other in odds]
        share = 1.0 / (1.0 + np.exp(-odds[cell[row]] - 1.5 * np.mean(beside or [0.0])))
        either = alone[row, 0] + alone[row, 1]
        most = max(either * share, either * (1.0 - share), alone[row, 2])
        assert classed.confidence[row] == pytest.approx(most, rel=1e-4)


def test_an_answer_does_not_depend_on_its_place_in_the_batch(stack, model):
    patches, measures = network_input(stack)
    whole = infer(model.content, {"patches": patches, "measures": measures})
    for rows in (slice(5, 6), slice(3, 40), slice(None, None, -1)):
        part = infer(model.content, {"patches": patches[rows], "measures": measures[rows]})
        assert_array_equal(part, whole[rows])


def test_other_files_are_refused(tmp_path, model):
    onnx = pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")
    old, textures = onnx.load_model_from_string(model.content), files("bumpymap.rating") / "data/models/textures.onnx"
    next(prop for prop in old.metadata_props if prop.key == "sector_version").value = "0"
    for content, said in (
        (b"no model", "is not an ONNX model"),
        (textures.read_bytes(), "not a scan network"),
        (old.SerializeToString(), "of version 0; this bumpymap uses version 3"),
    ):
        (tmp_path / "a.onnx").write_bytes(content)
        with pytest.raises(BadInputError, match=said):
            ScanModel.load(tmp_path / "a.onnx")


def relief(rms, smooth, count=40, seed=0):
    rng = np.random.default_rng(seed)
    maps = rng.standard_normal((count, 15, 15))
    maps = np.stack([gaussian_filter(m, smooth) for m in maps]) if smooth else maps
    maps -= maps.mean(axis=(1, 2), keepdims=True)
    return (rms * maps / maps.std(axis=(1, 2), keepdims=True)).astype(np.float32)


def gabor_weights(theta, at, settings):
    """Weights of pixels in the response at one: a wave under a Gaussian of one octave, 1 for stripes of its own."""
    sigma = 3.0 * math.sqrt(math.log(2.0) / 2.0) / math.pi * settings.wavelength_px
    down, right = (axis - place for axis, place in zip(np.mgrid[:15, :15], at, strict=True))
    u, v = right * math.cos(theta) + down * math.sin(theta), down * math.cos(theta) - right * math.sin(theta)
    envelope = np.exp(-0.5 * ((u / sigma) ** 2 + (v * settings.gamma / sigma) ** 2))
    wave = np.cos(2.0 * math.pi * u / settings.wavelength_px)
    return (envelope * wave / (envelope * wave**2).sum()).ravel()


@pytest.mark.parametrize("count", [1, 130])
@pytest.mark.parametrize("settings", [StripeFilter(), StripeFilter(wavelength_px=4.0, gamma=0.8, orientations=5)])
def test_counts_are_those_of_gabor_filters_in_a_plain_loop(settings, count):
    heights = relief(np.linspace(0.001, 0.2, count)[:, None, None], 1.0, count)
    angles = math.pi * np.arange(settings.orientations) / settings.orientations
    bank = np.array([[gabor_weights(theta, at, settings) for at in np.ndindex(15, 15)] for theta in angles])
    rows = np.arange(15)[:, None]
    expected = []
    for one in heights:
        moving_bars = np.cos(2 * np.pi * ((rows - 7) / settings.wavelength_px + one.astype(float) / 0.25)).ravel()
        answer = (bank @ moving_bars).max(axis=0).reshape(15, 15)
        starts = sum((column[i] >= 0.5) and (i == 0 or column[i - 1] < 0.5) for column in answer.T for i in range(15))
        expected.append(starts / 15)
    # An answer within a rounding of the threshold may fall on either side.
    np.testing.assert_allclose(count_stripes(heights, settings), expected, atol=2 / 15 + 1e-6)
    assert np.mean(np.abs(count_stripes(heights, settings) - expected) > 1e-6) < 0.05


def test_sectors_get_the_class_of_the_nearest_centre_raised_by_the_objects_on_them(stack):
    model = load_stripes()
    classed = classify_filter(stack, model)
    for row, class_id in enumerate(classed.class_id):
        objects = stack.count[row] - stack.ground_count[row]
        covered = stack.ground_count[row] < 0.55 * stack.count[row]
        standing = int(covered) + int(covered and stack.obstacle_count[row] >= 0.45 * objects)
        if not stack.traversable[row]:
            assert class_id == NOT_TRAVERSABLE
            assert np.isnan(classed.stripes[row])
        else:
            assert class_id == max(standing, min(range(3), key=lambda c: abs(model.centres[c] - classed.stripes[row])))
    means = [stack.residual[classed.class_id == class_id].mean() for class_id in range(3)]
    assert means[0] < means[1] < means[2]


HIGH_M = 1.7
HALF_M = 21.0


def relief_height():
    """Height of relief that grows northwards from almost none, a function of x and y [m]."""
    at = np.arange(-1.6 * HALF_M, 1.6 * HALF_M, 0.1)
    relief = fractal(np.random.default_rng(3), np.broadcast_to(at, (len(at), len(at))), 0.6, 0.1)
    field = RegularGridInterpolator((at, at), relief)
    return lambda x, y: np.clip((y + 15.0) / 30.0, 0.03, 1.0) * field((y, x)) - HIGH_M


def lines_on(ground, steepness):
    """Points where lines of a sensor meet the ground, as if it were even."""
    away = HIGH_M / np.tan(steepness)
    angle = np.linspace(-np.pi, np.pi, 1500, endpoint=False)
    x, y = (np.multiply.outer(away, part).ravel() for part in (np.cos(angle), np.sin(angle)))
    z = ground(x, y) + 0.01 * np.random.default_rng(1).standard_normal(len(x))
    return np.column_stack([x, y, z]).astype(np.float32)


@pytest.fixture(scope="module")
def ground():
    return relief_height()


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
    survey.x, survey.y, survey.z = x, y, ground(x, y)
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
    known, limits = ride.class_id != NO_CLASS, find_calibration("warthog").class_limits
    assert not (known & ~stack.traversable).any()
    assert (np.isfinite(ride.c_r) == known).all()
    assert (ride.class_id[known] >= np.searchsorted(limits, ride.c_r[known], side="right")).all()


def test_the_ride_does_not_depend_on_the_order_of_points(points, rater):
    shuffled = points[np.random.default_rng(4).permutation(len(points))]
    rides = [rater(Scan(each), polar_sectors(Scan(each))) for each in (points, shuffled)]
    for name in ("c_r", "c_r_low", "c_r_high", "class_id", "p_fail"):
        assert_array_equal(*(getattr(ride, name) for ride in rides))


@pytest.mark.parametrize(("limit", "classes"), [(5.0, {3}), (30.0, {0})])
def test_smooth_ground_that_is_too_steep_is_of_the_roughest_class(limit, classes):
    """It rises northwards by 8 degrees."""
    calibration = find_calibration("warthog")
    rater = SectorRater(replace(calibration, vehicle=calibration.vehicle | {"slope_limit_deg": limit}))
    slope = math.tan(math.radians(8.0))
    scan = Scan(lines_on(lambda _, y: slope * y - HIGH_M, np.radians(np.linspace(3.0, 50.0, 120))))
    stack = polar_sectors(scan)
    ride = rater(scan, stack)
    known = ride.class_id != NO_CLASS
    settings = GridSettings()
    seen = see_cells(scan.points, replace(classify_filter(stack), ride=ride), settings)
    cells = seen.finish(settings.resolution_m).occupancy
    assert ((cells == 100).mean() > 0.1) == (limit < 8.0)
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


def test_a_run_writes_what_the_classifier_returns(points, tmp_path):
    write_bin(tmp_path / "a.bin", points)
    how = {"vehicle": "car", "products": ("table", "cloud"), "columns": 4}
    scan_frames(ScanConfig((tmp_path / "a.bin",), tmp_path / "out", **how))
    result = bumpymap.classify_scan(points, vehicle="car")
    table = pq.read_table(tmp_path / "out" / "sectors.parquet").to_pydict()
    assert [NOT_TRAVERSABLE if own is None else own for own in table["class"]] == result.sector_class.tolist()
    vertex = read_vertices(tmp_path / "out" / "frames" / "a.ply")
    assert_array_equal(vertex["class"], result.point_class)
    assert_array_equal(vertex["x"], points[:, 0])
    c_r = np.array(table["c_r"], np.float32)
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


def revolution(seed, count=60_000, lost=0.1):
    """Ground around a sensor; some beams give no return."""
    rng = np.random.default_rng(seed)
    angle, distance = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.3, 45, count)
    z = -1.5 + np.where(angle < np.pi, 0.0, rng.normal(0, 0.15, count))
    points = np.column_stack([distance * np.cos(angle), distance * np.sin(angle), z]).astype(np.float32)
    points[rng.random(count) < lost] = np.nan
    return points


@pytest.mark.parametrize("method", ["filter", None])
def test_memory_neither_grows_nor_varies_from_scan_to_scan(method):
    classify = ScanClassifier(method=method)
    scans = [revolution(seed) for seed in range(8)]
    for scan in (revolution(0, lost=1e-4), scans[0]):  # buffers grow to the largest scan
        _ = classify(scan).grid
    tracemalloc.start()
    try:
        peaks, ends = [], []
        for scan in (*scans[3:], *scans[3:]):
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            _ = classify(scan).grid
            after, peak = tracemalloc.get_traced_memory()
            peaks.append(peak - before)
            ends.append(after)
    finally:
        tracemalloc.stop()
    assert max(peaks) < 1.1 * min(peaks)  # sectors come and go at the edge
    assert max(peaks) < 100 * len(scans[0]) + 2e6  # bytes a point, and the cells of the grid
    assert ends[-1] - ends[2] < 4 * len(scans[0])  # less than any array with a row per point, over 7 scans


@pytest.mark.parametrize("radius_m", [0.0, 0.5])
def test_a_grid_from_the_sensor_on_leaves_out_beams_without_return(radius_m):
    polar = {"zone_starts_m": (0.0, 4.0), "sectors": (16, 24), "rings": (2, 4), "end_m": 30.0}
    classify = ScanClassifier(method="filter", polar=polar, robot={"radius_m": radius_m})
    points = np.nan_to_num(revolution(0))
    nothing = (points == 0.0).all(axis=1)
    result, alone = classify(points), classify(points[~nothing])
    assert (result.point_class[nothing] == 255).all()
    np.testing.assert_array_equal(result.point_class[~nothing], alone.point_class)
    assert (alone.sector_class < 255).sum() > 50


@pytest.mark.parametrize("method", [None, "filter"])
def test_threads_share_a_classifier(method):
    classify = ScanClassifier(method=method)
    scans = [revolution(seed, count) for seed, count in enumerate((60_000, 15_000, 40_000, 15_000))]
    alone = [classify(scan).point_class.copy() for scan in scans]

    def classes(number):
        return classify(scans[number % len(scans)]).point_class.copy()

    with ThreadPoolExecutor(len(scans)) as threads:
        for number, found in enumerate(threads.map(classes, range(16))):
            np.testing.assert_array_equal(found, alone[number % len(scans)])


def test_a_classifier_goes_to_another_process_with_its_settings():
    classify, scan = ScanClassifier(method="filter", robot={"radius_m": 8.0}, vehicle="warthog"), revolution(0)
    here, there = classify(scan), copy.copy(classify)(scan)  # as pickle does it
    np.testing.assert_array_equal(here.point_class, there.point_class)
    np.testing.assert_array_equal(here.sector_c_r, there.sector_c_r)


def test_settings_that_contradict_the_vehicle():
    with pytest.raises(UsageError, match="leave out belly_m, or the vehicle"):
        bumpymap.ScanClassifier(vehicle="warthog", polar={"belly_m": 0.1})


CAMERA = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
PARKED, TRUCK = (12.07, 8.57, 0.0, 4.0, 1.8, 1.5), (22.0, -1.5, 0.6, 6.0, 2.4, 3.0)
"""Boxes: middle x and y, lower edge, length, width, upper edge, m."""
WALLS = [(x, y, 0.0, 3.0, 0.5, 2.5) for x, y in ((2.0, 11.0), (9.0, -8.0), (17.0, 12.0), (26.0, -9.0), (35.0, 10.0))]
FRAMES = 12


def seen(pose, boxes, columns=720):
    """Points (n, 3) of a sensor of 48 lines on level ground among boxes, in its frame, and which are ground."""
    up, around = np.radians(np.linspace(-28.0, 12.0, 48))[:, None], np.linspace(-np.pi, np.pi, columns, endpoint=False)
    rays = np.stack(np.broadcast_arrays(np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)), axis=-1)
    rays = rays.reshape(-1, 3)
    way, eye = rays @ pose[:3, :3].T, pose[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        away = np.where(way[:, 2] < 0.0, -eye[2] / way[:, 2], np.inf)
        ground = np.isfinite(away)
        for x, y, low, long, wide, high in boxes:
            near = (np.array([x - long / 2, y - wide / 2, low]) - eye) / way
            far = (np.array([x + long / 2, y + wide / 2, high]) - eye) / way
            enter, leave = np.minimum(near, far).max(axis=1), np.maximum(near, far).min(axis=1)
            hit = (enter > 0.0) & (enter < leave) & (enter < away)
            away, ground = np.where(hit, enter, away), ground & ~hit
    kept = away < 60.0
    return (rays * away[:, None])[kept].astype(np.float32), ground[kept]


def way_along(count=FRAMES, step=3.0):
    """Poses along a bend."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    turn = 0.3 * np.sin(np.arange(count) / 4.0 + 0.5)
    poses[:, 0, 0] = poses[:, 1, 1] = np.cos(turn)
    poses[:, 1, 0] = np.sin(turn)
    poses[:, 0, 1] = -np.sin(turn)
    poses[:, :2, 3] = np.cumsum(step * np.stack([np.cos(turn), np.sin(turn)], axis=1), axis=0) - [3.0, 0.0]
    poses[:, 2, 3] = 1.5
    return poses


def car(number):
    """The box of a car that comes towards the sensor."""
    return (38.0 - 4.0 * number, 2.0 - 0.1 * number, 0.2, 4.0, 1.8, 1.5)


@pytest.fixture(name="frames", scope="module")
def frames_fixture():
    """Frames of a drive past standing objects and a moving one."""
    return [seen(pose, [PARKED, TRUCK, *WALLS, car(number)]) for number, pose in enumerate(way_along())]


def merged(folder, frames, poses, is_ground=None, **how):
    """Merge frames; return the points, which are ground, and the record."""
    return merge(folder, frames, poses, is_ground, **how)[:3]


def merge(folder, frames, poses, is_ground=None, **how):
    """And the poses, corrected or not."""
    folder.mkdir()
    offset = np.round(poses[0, :3, 3])
    drive = DriveMerge(folder, offset, Robot(), **how)
    for number, ((points, ground), pose) in enumerate(zip(frames, poses, strict=True)):
        own = ground if is_ground is None else is_ground(number, points)
        drive.add_points(str(number), pose, place_points(str(number), points, own, pose, offset))
    with open_accumulated(folder / "a.laz", offset, None) as add_points:
        drive.write(add_points)
    las = laspy.read(folder / "a.laz")
    return np.asarray(las.xyz), np.asarray(las.classification) == 2, drive.record(), drive.poses


def in_box(xyz, box, margin=0.05):
    x, y, low, long, wide, high = box
    inside = np.abs(xyz - [x, y, 0.5 * (low + high)]) <= np.array([long, wide, high - low]) / 2 + margin
    return inside.all(axis=1)


@pytest.fixture(name="drive", scope="module")
def drive_fixture(frames, tmp_path_factory):
    return merged(tmp_path_factory.mktemp("merge") / "out", frames, way_along())


def test_what_moved_is_gone_and_what_stands_has_stayed(frames, drive):
    xyz, ground, record = drive
    poses = way_along()
    world = [points @ pose[:3, :3].T + pose[:3, 3] for (points, _), pose in zip(frames, poses, strict=True)]
    moving = sum(int(in_box(points, car(number)).sum()) for number, points in enumerate(world))
    assert moving > 1000
    of_cars = np.any([in_box(xyz, car(number)) for number in range(FRAMES)], axis=0) & (xyz[:, 2] > 0.3)
    elsewhere = np.any([in_box(xyz, box, 0.3) for box in (PARKED, TRUCK, *WALLS)], axis=0)
    assert (of_cars & ~elsewhere & ~ground).sum() < 0.02 * moving
    for box in (PARKED, *WALLS):
        voxels = {
            tuple(v) for points in world for v in np.floor(points[in_box(points, box)] / 0.2).astype(int).tolist()
        }
        left = {tuple(v) for v in np.floor(xyz[in_box(xyz, box)] / 0.2).astype(int).tolist()}
        assert len(voxels & left) > 0.97 * len(voxels) > 50
    assert record["seen"] == sum(len(points) for points in world)
    assert (record["points"], record["ground"]) == (len(xyz), ground.sum())
    assert (record["moving"] > 0, record["poses"]["misfits"]) == (True, [])
    # Density is even.
    whole = np.round(1000.0 * xyz).astype(np.int64)
    pixels = np.unique(whole[ground, :2] // 200, axis=0, return_counts=True)[1]
    assert pixels.max() == MOST_GROUND
    assert np.unique(whole[~ground] // 200, axis=0, return_counts=True)[1].max() <= MOST_OTHERS
    assert np.abs(xyz[ground, 2]).max() < 0.01


def test_ground_below_a_truck_is_not_ground_to_drive_on(frames, drive):
    xyz, ground, _ = drive
    x, y, _, long, wide, _ = TRUCK
    below = (x, y, -0.1, long - 0.9, wide - 0.9, 0.0)
    world = [points @ pose[:3, :3].T + pose[:3, 3] for (points, _), pose in zip(frames, way_along(), strict=True)]
    assert in_box(np.concatenate(world), below).sum() > 100
    assert not (in_box(xyz, below) & ground).any()


def test_where_blocks_begin_makes_no_difference(frames, drive, tmp_path):
    poses, by = way_along(), (-100_005.0, 3_999_987.0, 4.0)
    poses[:, :3, 3] += by
    xyz, ground, record = merged(tmp_path / "out", frames, poses)
    rows = [np.column_stack([np.round(1000.0 * p).astype(np.int64), g]) for p, g in ((xyz - by, ground), drive[:2])]
    first, second = (each[np.lexsort(each.T)] for each in rows)
    assert len(first) == len(second)
    assert (np.abs(first - second).max(axis=1) > 0).mean() < 1e-3  # a half millimetre may round to either side
    assert record["moving"] == pytest.approx(drive[2]["moving"], abs=5)


def test_ground_keeps_its_height_beside_the_border_of_two_voxels(frames, tmp_path):
    rng, poses = np.random.default_rng(5), way_along()
    poses[:, 2, 3] += 0.004
    noisy = [
        (points + np.outer(rng.normal(0.0, 0.01, len(points)) * is_ground, [0.0, 0.0, 1.0]), is_ground)
        for points, is_ground in frames
    ]
    xyz, ground, _ = merged(tmp_path / "out", [(each.astype(np.float32), own) for each, own in noisy], poses)
    assert xyz[ground, 2].mean() == pytest.approx(0.004, abs=0.0005)
    assert xyz[ground, 2].std() == pytest.approx(0.01, rel=0.05)


def test_what_most_frames_do_not_take_for_ground_is_no_ground(frames, tmp_path):
    def roofs(number, points):
        high = way_along()[number, 2, 3] + points[:, 2] > 0.3
        return frames[number][1] | (high & (number in {2, 7}))

    xyz, ground, _ = merged(tmp_path / "out", frames, way_along(), roofs)
    high = xyz[:, 2] > 0.3
    assert (high & ground).sum() < 0.1 * high.sum()


def relative(poses, apart=4):
    """Poses of frames in the one so many before."""
    return np.linalg.inv(poses[:-apart]) @ poses[apart:]


def noisy(poses, metres, degrees, seed=3):
    """Poses with errors of all six kinds."""
    rng, poses = np.random.default_rng(seed), poses.copy()
    poses[:, :3, 3] += rng.normal(0.0, metres, (len(poses), 3))
    turns = Rotation.from_rotvec(np.radians(rng.normal(0.0, degrees, (len(poses), 3)))).as_matrix()
    poses[:, :3, :3] = turns @ poses[:, :3, :3]
    return poses


def test_errors_of_poses_are_said_and_corrected_if_asked(tmp_path, caplog):
    true, given = way_along(), noisy(way_along(), 0.05, 0.3)
    boxes = [(x, y, 0.0, 2.0, 2.0, 2.5) for x, y in ((0.0, 9.0), (6.0, -6.0), (13.0, 9.0), (19.0, -4.0), (30.0, -3.0))]
    frames = [seen(pose, [PARKED, *WALLS, *boxes, car(number)]) for number, pose in enumerate(true)]
    kept, *_, same = given.copy(), *merge(tmp_path / "given", frames, given)
    np.testing.assert_array_equal(same, kept)
    assert "the height of the same ground differs" in caplog.text
    xyz, ground, record, found = merge(tmp_path / "out", frames, given, corrected=True)
    np.testing.assert_array_equal(given, kept)
    off = np.linalg.inv(relative(true)) @ relative(found)
    assert (np.median(np.linalg.norm(off[:, :3, 3], axis=1)) < 0.01) & (np.abs(off[:, 2, 3]).max() < 0.002)
    assert np.degrees(Rotation.from_matrix(off[:, :3, :3]).magnitude()).max() < 0.05
    corrected = record["poses"]["correction"]
    assert corrected["significant"] == corrected["edges"] > FRAMES
    np.testing.assert_array_equal([corrected["poses"][str(number)] for number in range(FRAMES)], found)
    assert corrected["surfaces_after_m"] < 0.1 * corrected["surfaces_before_m"]
    assert 0.05 < corrected["largest_move_m"] < 0.2
    near = ground & (np.abs(xyz[:, 0] - 15.0) < 10.0) & (np.abs(xyz[:, 1] - 2.0) < 3.0)
    plane = np.column_stack([xyz[near, :2], np.ones(near.sum())])
    rest = xyz[near, 2] - plane @ np.linalg.lstsq(plane, xyz[near, 2], rcond=None)[0]
    assert rest.std() < 0.01


def escorted(step, count, beside, boxes, columns=360):
    """Perfect poses on a bend, and frames with a car that keeps its place beside the sensor."""
    poses, rng = way_along(count, step), np.random.default_rng(2)
    frames = []
    for pose in poses:
        x, y = pose[:2, 3] + pose[:2, :2] @ beside
        points, ground = seen(pose, [*boxes, (x, y, 0.2, 4.0, 1.8, 1.5)], columns)
        frames.append((points + rng.normal(0.0, 0.01, points.shape).astype(np.float32), ground))
    return poses, frames


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.5, 1.0])
def test_perfect_poses_stay_beside_an_escort(step, tmp_path):
    poses, frames = escorted(step, 12, (1.5, 3.2), [PARKED, *WALLS[:2]])
    for corrected, most in ((False, 0.0), (True, 0.02)):
        *_, record, found = merge(tmp_path / str(corrected), frames, poses, corrected=corrected)
        assert np.abs(found - poses).max() <= most
        assert (record["poses"]["misfits"], record["poses"]["left_out"]) == ([], [])


@pytest.mark.slow
def test_the_robot_drove_where_others_followed_it(tmp_path):
    """A car that follows, and stops when the robot stops, is never seen through where it stands at the end."""
    poses, frames = escorted(0.5, 40, (-5.5, 0.0), WALLS, 360)
    frames, poses = [*frames, *20 * frames[-1:]], np.concatenate([poses, np.tile(poses[-1:], (20, 1, 1))])
    xyz, ground, record = merged(tmp_path / "out", frames, poses)
    away = np.linalg.norm(xyz[:, None, :2] - poses[None, 8:, :2, 3], axis=2).min(axis=1)
    assert record["moving"] > 1000
    assert not ((away < 1.0) & ~ground & (xyz[:, 2] > 0.25)).any()


def test_one_wrong_frame_is_named_and_left_out(frames, drive, tmp_path, caplog):
    poses = way_along()
    poses[7, :3, :3] = poses[7, :3, :3] @ Rotation.from_euler("x", 5.0, degrees=True).as_matrix()
    xyz, ground, record = merged(tmp_path / "out", frames, poses)
    assert record["poses"]["left_out"] == ["7"]
    assert "1 of 12 frames are left out" in caplog.text
    assert "7 against" in caplog.text
    assert np.abs(xyz[ground, 2]).max() < 0.01
    assert len(xyz) > 0.9 * len(drive[0])
    trusted = merged(tmp_path / "trusted", frames, poses, trusted=True)[2]["poses"]
    assert (trusted["left_out"], trusted["misfits"] != []) == ([], True)


def test_a_mounting_that_poses_lack_is_said_even_on_a_straight_way(tmp_path, caplog):
    level = np.tile(np.eye(4), (8, 1, 1))
    level[:, 0, 3], level[:, 2, 3] = 3.0 * np.arange(8), 1.5
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_euler("x", 5.0, degrees=True).as_matrix()
    frames = [seen(pose @ mount, [PARKED, *WALLS]) for pose in level]
    assert merged(tmp_path / "right", frames, level @ mount)[2]["poses"]["lean_deg"] is None
    assert not caplog.text
    lean = merged(tmp_path / "out", frames, level)[2]["poses"]["lean_deg"]
    assert lean == [pytest.approx(5.0, abs=0.3), pytest.approx(0.0, abs=0.3)]
    assert re.search(r"leaned by 5 degrees.*a roll of 4.9 and a pitch of .*Multiply each pose", caplog.text)


def test_frames_between_bare_walls_are_moved_across_and_not_along(tmp_path):
    true = np.tile(np.eye(4), (8, 1, 1))
    true[:, 0, 3], true[:, 2, 3] = 2.0 * np.arange(8), 1.5
    frames, rng = [], np.random.default_rng(1)
    for pose in true:
        points, ground = seen(pose, [(7.0, y, 0.0, 90.0, 0.4, 3.0) for y in (4.0, -4.0)])
        frames.append((points + rng.normal(0.0, 0.005, points.shape).astype(np.float32), ground))
    given, by = true.copy(), rng.normal(0.0, 0.2, (8, 2))
    given[:, :2, 3] += by
    moved = merge(tmp_path / "out", frames, given, trusted=True, corrected=True)[3][:, :2, 3] - given[:, :2, 3]
    assert np.abs(moved[:, 0]).max() < 0.02
    assert np.ptp(moved[:, 1] + by[:, 1]) < 0.03 < np.ptp(by[:, 1])


def off(by=(0.0, 0.0, 0.0), axis="z", degrees=0.0):
    """Poses that are moved in the world, then turned about an axis of the sensor; by the same or each."""
    poses = way_along()
    poses[:, :3, 3] += by
    poses[:, :3, :3] = poses[:, :3, :3] @ Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return poses


WAY, FLIP, LATER = way_along(), np.diag([1.0, -1.0, 1.0, 1.0]), np.arange(FRAMES)[:, None] >= 6
PLACE, YAW, NOISE = WAY[:, :3, 3], np.arctan2(WAY[:, 1, 0], WAY[:, 0, 0]), np.random.default_rng(5)
FAULTS = {
    "jump aside": (True, "6 against .: objects stand 1.5 m beside", off(LATER * [0.0, 1.5, 0.0])),
    "jump up": (False, "6 against .: the same ground is 0.50 m higher", off(LATER * [0.0, 0.0, 0.5])),
    "too long": (False, "as if all ways were 1.(09|10) times as long", off(PLACE * [0.1, 0.1, 0.0])),
    "too short": (False, "as if all ways were 0.(89|90) times as long", off(PLACE * [-0.1, -0.1, 0.0])),
    "leaning": (True, "as if the LiDAR leaned by 4 degrees", off(axis="y", degrees=4.0)),
    "rolled": (True, "as if the LiDAR leaned by 5 degrees", off(axis="x", degrees=5.0)),
    "turning": (True, "objects stand turned by 2 degrees", off(degrees=np.arange(FRAMES)[:, None])),
    "degrees": (True, "see through", off(degrees=np.degrees(np.degrees(YAW) - YAW)[:, None])),
    "a frame late": (False, "left out .*0 against", WAY[[0, *range(FRAMES - 1)]]),
    "mirrored": (True, "do not fit", FLIP @ WAY @ FLIP),
    "noisy": (False, "1. of 12 frames do not fit", off(NOISE.normal(0.0, 0.3, (FRAMES, 3)))),
    "x for y": (True, "do not fit", off(PLACE[:, [1, 0, 2]] - PLACE)),
    "exchanged": (
        False,
        "2 of 12 frames are left out .*5 against .*6 against",
        WAY[[0, 1, 2, 3, 4, 6, 5, 7, 8, 9, 10, 11]],
    ),
    "repeated": (False, "1 of 12 frames are left out .*6 against 5: it holds the same points", WAY),
    "inverted": (True, "see through", np.linalg.inv(WAY)),
    "of a camera": (True, "same ground differs", CAMERA @ WAY @ np.linalg.inv(CAMERA)),
    "far apart": (True, "so far apart", way_along(step=300.0)),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_wrong_poses_are_named_with_what_contradicts_them(frames, tmp_path, caplog, fault):
    refused, words, poses = FAULTS[fault]
    own = [frames[5 if fault == "repeated" and number == 6 else number] for number in range(FRAMES)]
    if refused:
        with pytest.raises(BadInputError, match=f"according to the poses, .*{words}.*`trust_poses=True`"):
            merged(tmp_path / "out", own, poses)
    else:
        assert merged(tmp_path / "out", own, poses)[2]["poses"]["misfits"]
        assert re.search(words, caplog.text)


START = 1_700_000_000.0
SPEED_MPS, TURN_RADPS = 9.0, 1.0
POSTS = np.random.default_rng(1).uniform(-20.0, 20.0, (40, 2))


def motion(times):
    """Rotations and places of a LiDAR 1.5 m above the ground, on a circle."""
    angle = TURN_RADPS * (np.asarray(times) - START)
    radius = SPEED_MPS / TURN_RADPS
    places = np.column_stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle)), np.full(len(angle), 1.5)])
    return Rotation.from_euler("z", angle[:, None]), places


def sweep(time, seed):
    """World points of posts and flat ground that one turn of 0.1 s sees, and the time of each after ``time``."""
    rng = np.random.default_rng(seed)
    ground = np.column_stack([rng.uniform(-25.0, 25.0, (6_000, 2)), np.zeros(6_000)])
    posts = np.column_stack([np.repeat(POSTS, 100, axis=0), np.tile(np.linspace(0.1, 2.0, 100), len(POSTS))])
    world = np.concatenate([ground, posts])
    _, place = motion([time])
    azimuth = np.arctan2(*(world - place)[:, 1::-1].T)
    offset = (azimuth + np.pi) * 0.1 / (2 * np.pi)
    order = np.argsort(offset)
    return world[order], offset[order]


@pytest.fixture(name="driven", scope="module")
def driven_fixture(tmp_path_factory):
    """Five frames with the time of each point in nanoseconds, and poses at 50 Hz."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "frames").mkdir()
    for number in range(5):
        time = START + 0.1 * number
        world, offset = sweep(time, number)
        turns, places = motion(time + offset)
        rows = np.zeros(len(world), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4")])
        for axis, values in zip("xyz", turns.inv().apply(world - places).T, strict=True):
            rows[axis] = values
        rows["t"] = np.rint(offset * 1e9)
        write_ply(folder / "frames" / f"{time:.3f}.ply", rows)
    times = START + np.arange(-5, 40) / 50.0
    turns, places = motion(times)
    np.savetxt(folder / "tum.txt", np.column_stack([times, places, turns.as_quat()]), fmt="%.9f")
    return folder


def settings(driven, out, **more):
    how = {"poses": driven / "tum.txt", "method": "filter", "products": ("table",)}
    return ScanConfig((driven / "frames",), out, **how | more)


def off_posts(out):
    """Distance of the points above the ground to the nearest post, m."""
    points = laspy.read(out / "gathered.laz").xyz
    high = points[points[:, 2] > 0.3, :2]
    return np.linalg.norm(high[:, None] - POSTS[None], axis=2).min(axis=1)


def test_a_drive_is_deskewed_by_the_poses_between_its_frames(driven, tmp_path):
    config = settings(driven, tmp_path / "out")
    scan_frames(config)
    assert off_posts(config.out).max() < 0.01
    raw = settings(driven, tmp_path / "raw", deskew=False)
    scan_frames(raw)
    assert off_posts(raw.out).max() > 0.5
    assert not json.loads((raw.out / "scan.json").read_text(encoding="utf-8"))["poses"]["deskew"]


def test_wrong_poses_leave_nothing_in_the_way_of_right_ones(driven, tmp_path):
    """The frames of a refused run are of no use: with the same poses it would be refused again."""
    table = np.loadtxt(driven / "tum.txt")
    right = table[:, 3].copy()
    table[:, 3] += 7.0 * (table[:, 0] - START)
    np.savetxt(tmp_path / "tum.txt", table, fmt="%.9f")
    config = settings(driven, tmp_path / "out", poses=tmp_path / "tum.txt", deskew=False)
    with pytest.raises(BadInputError, match="height of the same ground differs") as refused:
        scan_frames(config)
    assert not hasattr(refused.value, "__notes__")
    assert not config.out.exists()
    trusted = scan_frames(replace(config, out=tmp_path / "trusted", trust_poses=True))
    assert trusted.merged["poses"]["misfits"]
    table[:, 3] = right
    np.savetxt(tmp_path / "tum.txt", table, fmt="%.9f")
    assert not scan_frames(config).already_done


def test_a_correction_without_its_package_ends_before_the_work(driven, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    with pytest.raises(UsageError, match=r"pip install .*poses"):
        scan_frames(settings(driven, tmp_path / "out", correct_poses=True))
    assert not (tmp_path / "out").exists()
