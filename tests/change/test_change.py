"""Changes between two surveys: figures of a tile by hand, what counts as a change, and the files."""

import json
import math
from dataclasses import fields, replace
from functools import cache
from itertools import pairwise

import geopandas
import numpy as np
import pytest
import rasterio
import shapely
from cost_maps import COLS, ROWS, RUT, survey
from hypothesis import assume, given, settings, strategies as st
from point_files import las_bytes
from route_maps import RUN, VEHICLE, copy_folder, write_folder
from scipy import ndimage, stats

import bumpymap
from bumpymap.change.compare import SURE, GroundChange, compare_heights, decide, hold_false_discoveries, ride_change
from bumpymap.change.pipeline import CHANGE_FILES, connect, find_changes
from bumpymap.core import BadInputError, DiffConfig, Georeference, interval_log_sd
from bumpytiles import Grid

pytestmark = pytest.mark.usefixtures("without_views")

LAGS = [(0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)]
CHANCES = st.lists(st.one_of(st.floats(0.0, 1.0), st.just(float("nan"))), min_size=0, max_size=40)


def by_hand(tile):
    """z_height and z_shape of one tile, one pixel after the other."""

    def cut(values):
        return np.clip(values / max(1.4826 * np.nanmedian(np.abs(values)), 1e-3), -1.5, 1.5)

    level = cut(tile)
    form = cut(tile - np.nanmedian(tile))
    form = form - np.nanmean(form)
    products = []
    for row, col in np.ndindex(form.shape):
        for down, right in LAGS:
            if row + down < len(tile) and 0 <= col + right < len(tile):
                products.append(form[row, col] * form[row + down, col + right])
    own = level[np.isfinite(level)]
    t, freedom = stats.ttest_1samp(own, 0.0).statistic, len(own) - 1
    height = -np.sign(t) * stats.norm.ppf(stats.t.cdf(-abs(t), freedom))
    return height, np.nansum(products) / np.sqrt(np.nansum(np.square(products)))


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.floats(0.2, 1.0))
def test_figures_of_a_tile_are_those_made_by_hand(seed, seen):
    rng = np.random.default_rng(seed)
    tile = rng.normal(0.01, 0.05, (1, 15, 15))
    tile[rng.random(tile.shape) > seen] = np.nan
    found = compare_heights(tile)
    assert found.d_height[0] == pytest.approx(np.nanmean(tile))
    both = [min(pair, key=abs) for turn in (tile[0], tile[0].T) for row in turn for pair in pairwise(row)
            if np.prod(pair) > 0]  # fmt: skip
    assert found.d_largest[0] == max(both, key=abs, default=0.0)
    assert (found.z_height[0], found.z_shape[0]) == pytest.approx(by_hand(tile[0]))


def test_without_a_change_both_are_standard_normal_whatever_the_noise():
    """The size of the noise differs from pixel to pixel: a smooth path through a shrub."""
    rng = np.random.default_rng(0)
    size = np.where(np.arange(15) < 9, 0.01, 0.3)[None, :, None] * rng.uniform(0.5, 2.0, (4000, 1, 1))
    found = compare_heights(rng.standard_t(3, (4000, 15, 15)) * size)
    for z in (found.z_height, found.z_shape):
        assert z.mean() == pytest.approx(0.0, abs=0.5)
        assert z.std() == pytest.approx(1.0, abs=0.08)
        assert np.mean(z > 3.0) < 0.006
    assert found.z_height.mean() == pytest.approx(0.0, abs=0.06)


@pytest.mark.parametrize(("shared", "drives", "floor"), [(0.0, 0.0, 0.0), (0.1, 0.2, 0.0), (0.1, 0.0, 0.05)])
def test_ride_costs_are_compared_by_their_logarithms_less_what_both_maps_share(shared, drives, floor):
    own = 0.08
    tail = 1.2815515655446004 * math.sqrt(own**2 + shared**2 + drives**2)

    def bands(ground):
        c_r, low, high = (np.hypot(np.array(ground) * np.exp(by), floor) for by in (0.0, -tail, tail))
        return c_r, interval_log_sd(c_r, low, high, drives)

    common = (shared, floor)
    ratio, sd = ride_change(bands([0.1, 0.05, 0.102, np.nan]), bands([0.102, 0.051, 0.1, 0.1]), common)
    expected = np.log(1.02) / (own * np.sqrt(2.0))
    assert ratio / sd == pytest.approx([expected, expected, -expected, np.nan], rel=0.05, nan_ok=True)


@given(CHANCES, st.floats(0.01, 0.5))
def test_what_counts_as_found_is_the_rule_of_the_book(chances, share):
    chance = np.array(chances, float)
    known = np.isfinite(chance)
    adjusted = stats.false_discovery_control(chance[known]) if known.any() else chance[known]
    assume(not np.isclose(adjusted, share, rtol=1e-9).any())
    assert hold_false_discoveries(chance, share)[known].tolist() == (adjusted <= share).tolist()


def made_ground(rng, shape=(20, 30)):
    height, form = rng.standard_normal((2, *shape))
    even = np.full(shape, 0.01)
    return GroundChange(0.01 * height, 0.02 * height, height, form, even, 10 * even)


def made_ride(z, sd=0.1):
    return sd * z, np.full_like(z, sd)


def test_a_ride_that_jumps_over_ground_that_has_not_moved_is_no_change():
    rng = np.random.default_rng(1)
    found = made_ground(rng)
    ride = rng.standard_normal(found.z_height.shape)
    ride[:5] = 30.0
    assert not decide(found, made_ride(ride), 0.05).code.any()
    found.z_height[:5] = 9.0
    for jump, kind in ((30.0, 2), (-30.0, 3), (np.nan, 4), (0.5, 1)):
        code = decide(found, made_ride(np.where(ride == 30.0, jump, ride)), 0.05).code
        assert (code[:5] == kind).all()
        assert (code[5:] > 0).mean() < 0.02


def test_a_ride_on_changed_ground_is_tested_there_alone_by_the_chance_of_unchanged_ground_or_left_open():
    """Intervals hold errors that both surveys make alike: twice too wide, a z of 2 on a tenth of the tiles is proof."""
    rng = np.random.default_rng(2)
    found = made_ground(rng)
    found.z_height[:2] = 9.0
    ride = 0.5 * rng.standard_normal(found.z_height.shape)
    ride[:2] = 2.0
    done = decide(found, made_ride(ride, 0.3), 0.05)
    assert (done.code[:2] == 2).all()
    assert done.widened["c_r"] == pytest.approx(0.5, abs=0.05)
    ride[:2] = 0.8
    assert (decide(found, made_ride(ride, 0.3), 0.05).code[:2] == 5).all()  # exp(0.3 (0.8 + 1.28 / 2)) is above 1.5
    assert (decide(found, made_ride(ride, 0.1), 0.05).code[:2] == 1).all()
    few = GroundChange(*(getattr(found, each.name)[1:5, :24] for each in fields(GroundChange)))
    assert decide(few, made_ride(ride[1:5, :24]), 0.05).widened["c_r"] == 1.0


def test_surveys_that_do_not_fit_each_other_are_widened():
    """A tenth of the tiles has changed, which widens the middle half of the heights to 1.15."""
    loose = made_ground(np.random.default_rng(2), (100, 200))
    loose.z_height[:10] = 500.0
    loose.z_height[-1] = np.nan
    loose = replace(loose, z_height=3.0 * loose.z_height, z_shape=2.0 + 2.0 * loose.z_shape)
    ride = 2.0 * np.random.default_rng(3).standard_normal(loose.z_height.shape)
    done = decide(loose, made_ride(ride), 0.05)
    assert done.widened == pytest.approx({"height": 3.0 * 1.15, "shape": 2.0, "c_r": 2.0}, rel=0.05)
    assert (done.code[:10] > 0).all()
    assert (done.code[10:-1] > 0).mean() < 0.01
    calm = made_ground(np.random.default_rng(4))
    assert decide(replace(calm, z_height=0.5 * calm.z_height), made_ride(calm.z_shape), 0.05).widened["height"] == 1.0


@given(st.integers(0, 10_000), st.floats(0.05, 0.8), st.integers(1, 6))
def test_small_changes_are_dropped_and_the_others_numbered(seed, share, least):
    rng = np.random.default_rng(seed)
    code = np.where(rng.random((9, 12)) < share, rng.integers(1, 5, (9, 12)), 0).astype(float)
    code[rng.random(code.shape) < 0.1] = np.nan
    sure = rng.random(code.shape) < 0.03
    kept, area, dropped = connect(code, least, sure)
    labels, count = ndimage.label(np.nan_to_num(code) > 0)
    sizes = ndimage.sum_labels(np.ones(code.shape), labels, np.arange(1, count + 1))
    wanted = (sizes >= least) | (ndimage.sum_labels(sure, labels, np.arange(1, count + 1)) > 0)
    assert area.max() == sum(wanted)
    assert dropped == sizes[~wanted].sum()
    assert np.array_equal(area > 0, np.nan_to_num(kept) > 0)
    assert np.array_equal(np.isnan(kept), np.isnan(code))
    pairs = {(int(number), int(found)) for number, found in zip(area[area > 0], labels[area > 0], strict=True)}
    assert len(pairs) == area.max()


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """``again`` is as ``may`` was, but 0.4 m higher; ``june`` has a rut of 10 cm, three times as rough a ride."""
    folder = tmp_path_factory.mktemp("change")
    for name, made in {"may": survey(1), "again": survey(2, rise=0.4), "june": survey(3, rut=0.1, c_r=3.0)}.items():
        write_folder(folder / name, made)
    return folder


@cache
def compare(before, after, **options):
    return find_changes(DiffConfig(before, after, **options))


@pytest.fixture(scope="module")
def rut(root):
    """What has changed from ``may`` to ``june``, with its files."""
    return compare(root / "may", root / "june", out=root / "out", register=False)


def planted():
    mask = np.zeros((ROWS, COLS), bool)
    mask[tuple(np.array(RUT).T)] = True
    return mask


def test_without_a_change_next_to_nothing_is_found(root):
    result = compare(root / "may", root / "again", min_tiles=1)
    assert result.counts["compared"] == ROWS * COLS
    assert result.counts["changed"] <= 0.005 * ROWS * COLS
    assert result.fit["offset_m"] == pytest.approx(0.4, abs=0.002)
    assert any("lies 0.400 m higher" in note and "taken off" in note for note in result.notes)
    assert abs(np.nanstd(result.field.z_height) - 1.0) < 0.1


@pytest.mark.parametrize(("pixels", "compared"), [(3, 0), (4, ROWS * COLS)])
def test_maps_of_few_pixels_are_compared_pixel_by_pixel_or_it_is_said(pixels, compared, tmp_path):
    names, grid = ("may", "june"), Grid(3.0, pixels)
    result = compare(*(write_folder(tmp_path / name, survey(seed, grid=grid)) for seed, name in enumerate(names)))
    assert (result.fit["cell_m"], result.counts["compared"]) == (3.0 / pixels, compared)
    assert any("have too few pixels in common" in note for note in result.notes) == (compared == 0)


def test_a_rut_is_found_and_little_else(rut):
    found = rut.field.changed > 0
    assert found[planted()].mean() >= 0.9
    assert found[~planted()].sum() <= 0.05 * found.sum()
    assert (rut.field.changed[planted() & found] == 2).mean() > 0.9
    assert np.nanmedian(rut.field.d_height[planted()]) == pytest.approx(-0.1 * 3 / 15, abs=0.004)
    assert rut.field.d_c_r[planted()].mean() == pytest.approx(0.2, rel=0.05)


@pytest.mark.parametrize("seen", [1.0, 0.3])
def test_a_shift_and_a_tilt_are_found_on_unchanged_ground_and_taken_off(tmp_path, seen):
    rise = np.tan(np.radians(0.05))
    moved = {"shift": (0.24, -0.18), "tilt": (0.6 * rise, 0.8 * rise), "rise": 0.1}
    may = write_folder(tmp_path / "may", survey(21, seen=seen))
    june = write_folder(tmp_path / "june", survey(22, seen=seen, lowered=0.3, **moved))
    result, kept = compare(may, june), compare(may, june, register=False)
    found = result.fit["registration"]
    assert result.fit["cell_m"] == pytest.approx(0.2 if seen == 1.0 else 0.6)
    assert found["shift_m"] == pytest.approx(moved["shift"], abs=0.02)
    assert found["tilt_deg"] == pytest.approx(0.05, abs=0.005)
    assert found["rises_towards_deg"] == pytest.approx(np.degrees(np.arctan2(0.6, 0.8)), abs=5.0)
    assert all(factor < 1.3 for factor in result.fit["widened"].values())
    assert (result.field.changed[planted()] > 0).all()
    assert (result.field.changed[~planted()] > 0).mean() < 0.005
    assert sum("taken off" in note for note in result.notes) == 3
    assert kept.fit["registration"] is None
    assert kept.fit["widened"]["height"] > 3.0


def test_nothing_is_taken_off_that_is_not_above_its_error_or_cannot_be_told(root, tmp_path):
    pairs = (compare(root / "may", root / name, min_tiles=1) for name in ("may", "again"))
    same, again = (result.fit["registration"] for result in pairs)
    assert (same["shift_m"], same["tilt_deg"]) == ([0.0, 0.0], 0.0)
    assert [same["shift_taken_off"], same["tilt_taken_off"], again["shift_taken_off"]] == [False] * 3
    assert 0.0 < np.hypot(*again["shift_m"]) < 4.0 * max(again["shift_sd_m"])
    flat = [write_folder(tmp_path / str(seed), survey(seed, relief=0.0)) for seed in (1, 2)]
    result = compare(*flat)
    assert result.fit["registration"]["shift_m"] is None
    assert any("too little relief" in note for note in result.notes)


def mapped(path, seed, *, density=100.0, noise=0.02, rut=0.0, pile=0.0):
    """Map made points: rolling, uneven ground, a rut of 0.4 m width through 30 tiles of the row in the middle.

    ``pile``: m3 of a heap on one tile.
    """
    rng, bumps = np.random.default_rng(seed), np.random.default_rng(0)
    east, north = rng.uniform(0.0, 1.0, (2, rng.poisson(density * 108 * 27))) * [[108.0], [27.0]]
    waves = bumps.normal(0.0, 1.0, (60, 2)) * np.geomspace(0.2, 6.0, 60)[:, None]
    height, (x, y) = noise * rng.standard_normal(len(east)), np.float32([east, north])
    for wave, phase in zip(waves, bumps.uniform(0.0, 6.0, 60), strict=True):
        height += (
            0.012
            / np.hypot(0.5, np.hypot(*wave))
            * np.sin(np.float32(wave[0]) * x + np.float32(wave[1]) * y + np.float32(phase))
        )
    height -= rut * ((abs(north - 13.5) < 0.2) & (east > 9.0) & (east < 99.0))
    height += pile / (2 * np.pi * 0.81) * np.exp(-((east - 40.5) ** 2 + (north - 19.5) ** 2) / 1.62)
    points = np.column_stack([480_000.0 + east, 2_136_000.0 + north, 2_300.0 + height])
    path.with_suffix(".las").write_bytes(las_bytes(points, offset=(480_000.0, 2_136_000.0, 2_300.0)))
    return bumpymap.map_survey(path.with_suffix(".las"), path, crs="EPSG:32614")


@pytest.mark.parametrize("pile", [2.0, -2.0])
def test_a_heap_and_a_pit_on_one_tile_of_a_thin_survey_are_found_and_measured(tmp_path, pile):
    before = mapped(tmp_path / "before", 1, density=10.0)
    result = bumpymap.diff_surveys(before, mapped(tmp_path / "after", 2, density=10.0, pile=pile))
    assert (result.counts["changed"], result.counts["regions"]) == (1, 1)
    volumes, name = result.counts["volumes"], "heaped" if pile > 0 else "dug"
    assert volumes[f"{name}_m3"] == pytest.approx(abs(pile), abs=3 * volumes[f"{name}_sd_m3"])
    half, most = result.fit["least_volume_m3"]
    assert 0.0 < half <= most < 2.0


@pytest.mark.parametrize("side", [5, 15])
def test_the_smallest_heap_that_is_said_to_be_found_is_found(side):
    rng, x = np.random.default_rng(3), (np.arange(side) + 0.5) / side - 0.5
    heap = np.exp(-(x[:, None] ** 2 + x**2) / (2 * 0.3**2))
    noise = rng.normal(0.0, 0.04, (2000, side, side))
    found = compare_heights(noise)
    least = np.median(found.least_height)
    assert np.median(found.sd_height) == pytest.approx(0.04 / side, rel=0.1)
    for times, low, high in ((1.1, 0.9, 1.0), (0.4, 0.0, 0.6)):
        raised = compare_heights(noise + times * least * heap / heap.mean())
        assert low <= (np.fmax(np.abs(raised.z_height), raised.z_shape) >= SURE).mean() <= high
    few = np.where(rng.random(noise.shape) < 17 / side**2, noise, np.nan)
    assert np.isinf(np.nanmedian(compare_heights(few).least_height))


def test_a_rut_of_10_cm_is_felt_and_unchanged_ground_is_not(tmp_path):
    """Tested among all tiles, by intervals that hold errors of both surveys alike, no ride had changed."""
    before = mapped(tmp_path / "before", 1)
    result = bumpymap.diff_surveys(before, mapped(tmp_path / "rut", 2, rut=0.1))
    rougher = result.field.changed == 2
    assert rougher.sum() >= 27
    assert np.unique(np.nonzero(rougher)[0]).size == 1
    assert result.field.d_largest[rougher] == pytest.approx(-0.1, abs=0.06)
    for density, noise in ((100.0, 0.02), (40.0, 0.03)):
        plain = mapped(tmp_path / f"plain{density:.0f}", 3, density=density, noise=noise)
        same = bumpymap.diff_surveys(before, plain)
        assert (same.counts["by_change"]["rougher"], same.counts["by_change"]["smoother"]) == (0, 0)
    assert any("unlike densities, 40 and 100 points" in note for note in same.notes)


def test_an_offset_that_is_given_is_the_one_taken_off(root):
    result = compare(root / "may", root / "again", offset=0.0, register=False)
    assert result.counts["changed"] == ROWS * COLS
    assert np.median(result.field.d_height) == pytest.approx(0.4, abs=0.01)
    assert any("as asked" in note for note in result.notes)
    assert any("too many" in note for note in result.notes)


def test_the_error_that_both_maps_share_is_taken_off(root):
    knows = RUN["calibration"] | {"model_error": 0.08}
    both = [
        copy_folder(site, root / f"{site.name}_shared", calibration=knows) for site in (root / "may", root / "june")
    ]
    pairs = (root / "may", root / "june"), both, (both[0], root / "june")
    results = [compare(*pair, register=False) for pair in pairs]
    plain, taken, mixed = (one.field.z_c_r * one.fit["widened"]["c_r"] for one in results)
    assert np.array_equal(mixed, plain)
    own = np.sqrt((np.log(1.13) / 1.2816) ** 2 - 0.08**2)
    assert np.median(taken / plain) == pytest.approx(np.log(1.13) / 1.2816 / own, rel=0.05)


def test_only_tiles_of_both_are_compared_and_a_ride_that_differs_everywhere_is_noted(root):
    half = np.arange(COLS)[None, :] < np.where(np.arange(ROWS) < 10, 25, 22)[:, None]
    made = survey(5, tiles=half)
    for ride in (made.c_r, made.c_r_low, made.c_r_high):
        np.multiply(ride, 2.0, out=ride)
    part = write_folder(root / "part", made)
    result = compare(root / "may", part, register=False)
    assert result.counts["in_both"] == half.sum()
    assert (result.field.placement.window.cols, result.field.placement.window.rows) == (25, ROWS)
    assert np.array_equal(np.isfinite(result.field.changed), half[:, :25])
    assert any("the ride cost of the median tile is 2.0" in note for note in result.notes)


def test_files_say_what_the_result_says(rut):
    assert [path.name for path in rut.files] == [*CHANGE_FILES.names]
    assert {path.name for path in rut.folder.iterdir() if not path.name.startswith(".")} == {*CHANGE_FILES.names}
    with rasterio.open(rut.folder / "change.tif") as file:
        names = "d_c_r", "z_c_r", "d_height", "d_largest", "z_height", "z_shape", "sd_height", "least_volume", "changed"
        assert file.descriptions == names
        assert file.crs.to_epsg() == 32614
        assert (file.transform.c, file.transform.f) == (160_000 * 3.0, 712_030 * 3.0)
        for name, band in zip(file.descriptions, file.read(), strict=True):
            assert np.array_equal(band, getattr(rut.field, name), equal_nan=True)
    record = json.loads((rut.folder / "change.json").read_text())
    assert record["counts"] == json.loads(json.dumps(rut.counts))
    assert np.array_equal(record["classes"]["tiles_before_after"], rut.transitions)
    assert record["crs"]["code"] == "EPSG:32614"
    assert record["grid"] == {"tile_size_m": 3.0, "pixels": 15}
    assert {file["path"] for file in record["files"]} == {"change.tif", "change.geojson"}


def test_features_are_the_changes(rut):
    collection = json.loads((rut.folder / "change.geojson").read_text())
    features = collection["features"]
    assert [feature["id"] for feature in features] == list(range(1, rut.counts["regions"] + 1))
    assert sum(feature["properties"]["tiles"] for feature in features) == rut.counts["changed"]
    largest = max(features, key=lambda feature: feature["properties"]["tiles"])
    about = largest["properties"]
    assert shapely.geometry.shape(largest["geometry"]).is_valid
    assert about["volume_m3"] == pytest.approx(about["d_height"] * about["area_m2"], abs=0.1)
    assert about["volume_m3"] == pytest.approx(-0.1 * 0.6 * 3.0 * about["tiles"], rel=0.15)
    volumes = rut.counts["volumes"]
    dug = -sum(min(feature["properties"]["volume_m3"], 0.0) for feature in features)
    assert (volumes["dug_m3"], volumes["heaped_m3"]) == pytest.approx((dug, 0.0), rel=0.05)
    assert 0.0 < volumes["dug_sd_m3"] < 0.2 * dug
    assert about["volume_sd_m3"] <= volumes["dug_sd_m3"]
    assert about["kind"] == "rougher"
    assert about["rougher"] + about["smoother"] + about["ground_changed_ride_as_before"] == about["tiles"]
    west, south, east, north = collection["bbox"]
    assert -180 <= west < east <= 180 > north > south
    table = geopandas.read_file(rut.folder / "change.geojson").to_crs(32614)
    assert np.allclose(table.area, table["area_m2"], rtol=2e-3)


@pytest.mark.parametrize(
    ("options", "changes", "word"),
    [
        ({}, {"vehicle": VEHICLE | {"name": "car"}}, "vehicle is"),
        ({}, {"calibration": RUN["calibration"] | {"id": "beef"}}, "calibration is c0ffee and beef"),
        ({}, {"settings": {"rating": "table", "compat": "none"}}, "rating is"),
        ({}, {"ground_only": True}, "ground points only is"),
        ({"grid": Grid(3.0, 10)}, {}, "pixels along a tile is 15 and 10"),
        ({"georeference": Georeference(None)}, {}, "CRS is"),
    ],
)
def test_unlike_surveys_are_refused(root, tmp_path, options, changes, word):
    other = write_folder(tmp_path / "other", survey(6, tiles=np.indices((ROWS, COLS))[0] < 2, **options), **changes)
    with pytest.raises(BadInputError, match="cannot be compared") as caught:
        compare(root / "may", other, out=tmp_path / "out")
    assert all(told in str(caught.value) for told in (word, str(root / "may"), str(other)))
    assert not (tmp_path / "out").exists()
