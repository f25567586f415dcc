"""Classes of sectors: the network, the stripes of the filter method, the ride of a vehicle, and the loop of a robot."""

import copy
import json
import math
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.resources import files

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from made_frames import write_bin
from numpy.testing import assert_array_equal
from ply_files import read_vertices
from scan_scenes.things import make_field
from scipy.ndimage import gaussian_filter

import bumpymap
from bumpymap import ScanClassifier
from bumpymap.core import NO_CLASS, NOT_TRAVERSABLE, GridSettings, Scan, cell_numbers, sector_bounds
from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.rating import find_calibration
from bumpymap.scan import ScanConfig, classify_filter, load_stripes, polar_sectors, scan_frames
from bumpymap.scan.cells import lay_grid
from bumpymap.scan.classifier import SectorRater
from bumpymap.scan.learned import ScanModel, classify_learned, infer, neighbours, network_input, probabilities
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
    field = make_field(np.random.default_rng(3), 512, 0.05, 0.6, (0.3, 6.0))
    return lambda x, y: 0.1 * np.clip((y + 15.0) / 30.0, 0.03, 1.0) * field.at(x, y) - HIGH_M


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
    cells = lay_grid(scan.points, replace(classify_filter(stack), ride=ride), GridSettings()).occupancy
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
