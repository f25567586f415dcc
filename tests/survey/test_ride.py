"""Ground and ride of a survey: other speeds, few points; one map however points are delivered and cut."""

import json
import re
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import rasterio
from hypothesis import HealthCheck, given, settings, strategies as st
from scipy.ndimage import label, map_coordinates
from small_surveys import SIDES, alike_surveys, files_in, killed_at, layers_of, run, write_las, write_survey

import bumpymap
from bumpymap.core import INCLUDED_PIXELS, MapConfig, UsageError, with_pixels
from bumpymap.lab.terrains import fractal
from bumpymap.layers import PRODUCT_NAMES, MapFile
from bumpymap.rating import DRIVE_LOG_SD, Calibration, RideModel, shipped_calibrations
from bumpymap.survey.tile_rating import RatingModels

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("without_views")]

EAST, NORTH = 500_013.0, 4_000_020.0
SEAM = 52.0
"""m from the west; not a border of tiles."""


def made_site(code, seed=0, size=(108.0, 60.0)):
    """Rolling ground with bushes and a wall across the border of a classified part and one of class ``code``.

    Returns x, y, z [m] and class of each point.
    """
    rng = np.random.default_rng(seed)
    x, y = (np.round(rng.uniform(0.0, side, int(60 * size[0] * size[1])), 3) for side in size)
    z = 0.03 * x + 0.3 * np.sin(x / 9.0) + rng.normal(0.0, 0.01, len(x))
    bush = ((x // 6 + y // 6) % 3 == 0) & (rng.random(len(x)) < 0.2)
    wall = (np.abs(y - 31.0) < 0.4) & (x > 20.0) & (x < 80.0)
    z += np.where(wall, 1.5, np.where(bush, rng.uniform(0.0, 1.0, len(x)), 0.0))
    classes = np.where(x > SEAM, code, np.where(wall | bush, 1, 2))
    return np.column_stack([x, y, np.round(z, 3), classes])


def write(path, points):
    x, y, z, classes = points.T
    return write_las(path, EAST + x, NORTH + y, z, classification=classes.astype(np.uint8))


def mapped(surveys, out, *options):
    run("map", *surveys, "--out", out, "--quiet", *options, code=0)
    return json.loads((out / "run.json").read_text()), pq.read_table(out / "tiles.parquet").drop(["bbox", "geometry"])


def same(one, other, chosen):
    """Compare the chosen rows of two tables, in the columns of the second but for the zones of a map."""
    rows = [table.filter(pa.array(chosen)) for table in (one.select(other.column_names), other)]
    heights = [np.stack(each["heights"].to_numpy()) for each in rows]
    frames = [each.drop(["heights", "zone"]).to_pandas() for each in rows]
    return np.array_equal(*heights, equal_nan=True) and frames[0].equals(frames[1])


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    """Layers of the site as it comes, of class 1 in the east, and of all and of ground points alone."""
    folder = tmp_path_factory.mktemp("mixed")
    survey = write(folder / "site.laz", made_site(1))
    return folder, {kind: mapped([survey], folder / kind, "--ground", kind) for kind in ("auto", "all", "class")}


def test_each_part_is_rated_as_if_it_were_the_whole_survey(mixed):
    folder, found = mixed
    record, table = found["auto"]
    from_seam = 3.0 * table["col"].to_numpy() + 1.5 - EAST - SEAM
    source = table["ground_source"].to_numpy()
    assert np.array_equal(source[np.abs(from_seam) > 3.0], (from_seam > 0)[np.abs(from_seam) > 3.0])
    assert record["tiles_from_all_points"] == source.sum()
    known = table["class"].is_valid().to_numpy(zero_copy_only=False)
    assert known[np.abs(from_seam) < 3.0].mean() > 0.9
    dense = table["coverage"].to_numpy() > 0.8  # the noise of thin tiles is that of their whole block
    assert same(table, found["all"][1], dense & (from_seam > 6.0))
    assert same(table, found["class"][1], dense & (from_seam < -6.0))
    assert not same(table, found["class"][1], dense & (from_seam > 6.0))
    told = run("map", folder / "site.laz", "--out", folder / "auto").output
    assert f"measured from ground points, {source.sum()} from all points: that part of the survey is not c" in told
    assert "ground_source" not in found["all"][1].column_names + found["class"][1].column_names
    told = " ".join(run("info", folder / "site.laz").output.split())
    about, of = map(int, re.search(r"about (\d+) tiles of (\d+) are of a part that is not classified", told).groups())
    assert (of, about) == (len(source), pytest.approx(source.sum(), rel=0.06))


def test_no_way_leads_over_the_wall_that_stands_on_both_sides_of_the_border(mixed):
    table = mixed[1]["auto"][1]
    x, y = (3.0 * table[axis].to_numpy() + 1.5 - first for axis, first in (("col", EAST), ("row", NORTH)))
    passable = table["passable"].to_numpy(zero_copy_only=False)
    beside = passable & (x > 24.0) & (x < 76.0)
    tiles = np.zeros((40, 40), np.bool_)
    at = (y // 3).astype(int), (x // 3).astype(int)
    tiles[at] = beside
    areas = label(tiles, np.ones((3, 3)))[0][at]
    south, north = (set(areas[beside & (side * (y - 31.0) > 2.0)].tolist()) for side in (-1, 1))
    assert south
    assert north
    assert not south & north
    assert passable[np.abs(y - 31.0) > 6.0].mean() > 0.5


def test_a_run_killed_on_the_way_goes_on(mixed, tmp_path, limit_points):
    folder, _ = mixed
    limit_points(chunk=40_000, waiting=100_000)
    killed_at("survey.engine.run._save_joined", tmp_path / "out", folder / "site.laz")
    run("map", folder / "site.laz", "--out", tmp_path / "out", code=0)
    assert layers_of(tmp_path / "out") == layers_of(folder / "auto")


def test_where_most_was_never_classified_the_rest_is_still_measured_from_its_ground(tmp_path):
    points = made_site(0)
    points[points[:, 0] > 30.0, 3] = 0
    record, table = mapped([write(tmp_path / "site.laz", points)], tmp_path / "out")
    assert record["ground_only"]
    assert 0.6 < record["tiles_from_all_points"] / len(table) < 0.8


def test_roofs_water_and_woods_in_a_classified_survey_are_no_ground(tmp_path):
    """A roof of 20 m, a pond without points and a wood of 36 m at the edge, all of class 1 without ground below."""
    x, y, z, classes = made_site(2).T
    classes[(classes == 2) & (x > SEAM)] = 2
    roof, pond, wood = (x > 20) & (x < 40) & (y > 34) & (y < 54), (x > 10) & (x < 30) & (y < 16), x > 72
    z, classes = z + np.where(roof, 5.0, np.where(wood, 6.0, 0.0)), np.where(roof | wood, 1, classes)
    survey = write(tmp_path / "site.laz", np.column_stack([x, y, z, classes])[~pond])
    record, table = mapped([survey], tmp_path / "auto")
    mapped([survey], tmp_path / "class", "--ground", "class")
    refused = run("map", survey, "--out", tmp_path / "none", "--ground", "class", "--ground-classes", "40")
    assert (refused.exit_code, "has a class of --ground-classes" in refused.output) == (3, True), refused.output
    assert record["ground_only"]
    assert "tiles_from_all_points" not in record
    assert layers_of(tmp_path / "auto") == layers_of(tmp_path / "class")
    east = 3.0 * table["col"].to_numpy() - EAST
    north = 3.0 * table["row"].to_numpy() - NORTH
    inside = (east > 73) | ((east > 20) & (east < 37) & (north > 34) & (north < 51))
    assert inside.sum() > 200
    assert set(np.array(table["reason_text"])[inside]) == {"no ground points"}
    assert bumpymap.open(tmp_path / "auto").tiles()["class"][inside].isna().all()


CRS = "EPSG:32614"


def made_road(path, density, ramp):
    """A meadow with a road of 9 m from west to east, in the middle on a bridge over a valley 5 m deep.

    Its last 12 m in the east are of the class ``ramp``.
    """
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0.0, 60.0, (2, int(density * 60 * 48)))
    on_road, valley = np.abs(y - 24.0) < 4.5, np.abs(x - 30.0) < 9.0
    is_deck = on_road & valley
    z = np.where(valley & ~is_deck, -5.0, 0.0) + rng.normal(0.0, 0.02, len(x))
    classes = np.select([is_deck, on_road & (x > 48.0), on_road], [17, ramp, 11], 2)
    beneath = is_deck & (np.abs(y - 24.0) > 3.5) & (rng.random(len(x)) < 0.3)  # seen from the side
    z, classes = np.where(beneath, -5.0, z), np.where(beneath, 2, classes)
    house = (x > 3) & (x < 9) & (y > 3) & (y < 9)
    z, classes = np.where(house, 4.0, z), np.where(house, 6, classes)
    write_las(path, 500_000 + x, 4_000_000 + y, z, crs=CRS, offset=(500_000, 4_000_000, 0), classification=classes)


@pytest.mark.parametrize("density", [50, pytest.param(450, marks=pytest.mark.later)])
def test_classes_of_one_survey_together(tmp_path, density):
    """Ground, a building, a road, a bridge deck and structures of class 26, flush with the road."""
    made_road(tmp_path / "road.laz", density, ramp=26)
    for folder, more in (("without", ()), ("out", ("--ground-classes", "2,11,17,26"))):
        run("map", tmp_path / "road.laz", "--out", tmp_path / folder, "--quiet", *more, code=0)
        table = bumpymap.open(tmp_path / folder).tiles()
        x, y = (3.0 * table[axis].to_numpy() + 1.5 - at for axis, at in (("col", 500_000), ("row", 4_000_000)))
        road, deck = np.abs(y - 24.0) < 3.0, np.abs(x - 30.0) < 7.5
        ends = road & ((np.abs(x - 10.5) < 8.5) | ((x > 41.0) & (x < 47.0)))
        for part in (ends, (np.abs(y - 24.0) < 2.0) & deck):
            assert part.sum() >= 4
            assert (table["class"][part] == 0).all()
            assert table["passable"][part].all()
        assert not table["passable"][(np.abs(np.abs(y - 24.0) - 4.5) < 1.5) & (np.abs(x - 30.0) < 6.0)].any()
        on_ramp = table[road & (x > 49.0) & (x < 59.0)]
        assert len(on_ramp) >= 4
        assert (on_ramp["class"] == 0).all() if more else (on_ramp["reason_text"] == "no ground points").all()
    told = run("info", tmp_path / "road.laz", "--set", "ground_classes=2,26").output
    assert "; ground" in told.split("class 26", 1)[1].splitlines()[0]


def test_info_names_classes_that_lie_on_the_ground_with_their_share_and_height(tmp_path):
    """A track of class 40, named in the file, and trees of class 64, 4 m above the ground beside them."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0.0, 60.0, (2, 60_000))
    classes = np.select([np.abs(y - 31.5) < 4.5, (np.abs(y - 48.0) < 3.0) & (rng.random(len(x)) < 0.5)], [40, 64], 2)
    z = 0.1 * x + np.where(classes == 64, 4.0, 0.0)
    survey = laspy.create(point_format=6, file_version="1.4")
    lookup = b"".join(bytes([code]) + name.ljust(15, b"\0") for code, name in ((40, b"forest track"), (64, b"\x01bad")))
    survey.header.vlrs.append(laspy.VLR("LASF_Spec", 0, "Classification lookup", lookup))
    survey.header.scales, survey.header.offsets = [0.001] * 3, [500_001.0, 4_000_002.0, 0.0]
    survey.x, survey.y, survey.z = 500_001.0 + x, 4_000_002.0 + y, z
    survey.classification = classes.astype(np.uint8)
    survey.write(str(tmp_path / "a.laz"))
    words = ("info", tmp_path / "a.laz", "--crs", CRS)
    facts = json.loads(run(*words, "--json").stdout)["files"][0]
    assert facts["class_names"] == {"40": "forest track"}
    assert facts["class_tiles"] == pytest.approx({"2": 0.85, "40": 0.15, "64": 0.1}, abs=0.005)
    heights = facts["class_heights_m"]
    assert heights.pop("2") is None
    assert heights == pytest.approx({"40": 0.0, "64": 4.0}, abs=0.05)
    told = run(*words).output
    assert re.search(r"class 40 +forest track: 1[45]\.\d% of the points, in 15% of the tiles", told)
    assert "points of class 40 lie on the ground" in told
    assert "--ground-classes 2,11,17,40" in told
    assert "lie on the ground" not in run(*words, "--set", "ground_classes=2,40").output


# ---- the ride ----


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """Rubble in the east; in the north-west, points so few that tiles have no heightmap."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0.01, 29.99, (2, 60_000))
    kept = (x > 12) | (y < 18) | (rng.random(60_000) < 0.05)
    x, y = x[kept], y[kept]
    z = 100 + 0.02 * x + np.where(x > 15, 0.15 * np.sin(5 * x) * np.sin(4 * y), 0.0) + 0.004 * rng.normal(size=len(x))
    return write_las(tmp_path_factory.mktemp("survey") / "site.laz", x + 500_001, y + 4_000_002, z)


@pytest.fixture(scope="module")
def maps(survey, tmp_path_factory):
    """The map, and that at 2 m/s."""
    out = tmp_path_factory.mktemp("maps")
    for name, options in {"plain": (), "fast": ("--speed", 2)}.items():
        run("map", survey, "--out", out / name, *options, code=0)
    return out


def bands(path):
    with rasterio.open(path) as file:
        return dict(zip(file.descriptions, file.read(), strict=True))


def test_layers_say_their_speed_and_fail_as_before(maps):
    with rasterio.open(maps / "fast" / "rasters/class.tif") as file:
        tags = file.tags()
    assert (tags["speed_m_per_s"], tags["p_fail_speed_m_per_s"]) == ("2.0", "1.0")
    vehicle = json.loads((maps / "fast" / "run.json").read_text())["vehicle"]
    assert (vehicle["speed_mps"], vehicle["drives_mps"]) == (2.0, 1.0)
    slow, fast = (bands(maps / name / "rasters/roughness.tif")["p_fail"] for name in ("plain", "fast"))
    np.testing.assert_allclose(fast, slow, rtol=0.1)  # tiles of few points are pulled to their neighbours
    dense = bands(maps / "plain" / "rasters/roughness.tif")["coverage"] > 0.75
    np.testing.assert_allclose(fast[dense], slow[dense], rtol=1e-5)


SIDE = 48.0


def mapped_meadow(folder, density, noise=0.01, rms=0.0, thin_east=1.0):
    """Map a meadow without classes; return its tiles. ``thin_east``: share of the points of its eastern half."""
    rng = np.random.default_rng(11)
    x, y = rng.uniform(0.0, SIDE, (2, int(density * SIDE**2)))
    kept = (x < SIDE / 2) | (rng.random(len(x)) < thin_east)
    x, y, z = x[kept], y[kept], noise * rng.standard_normal(kept.sum())
    if rms:
        step = 0.1
        axis = np.broadcast_to(np.arange(0.0, SIDE, step), (int(SIDE / step),) * 2)
        z += map_coordinates(fractal(rng, axis, 0.5, rms), [y / step, x / step], order=1, mode="nearest")
    write_las(folder / "meadow.las", 500_000 + x, 4_000_000 + y, z)
    run("map", folder / "meadow.las", "--out", folder / "out", "--quiet", code=0)
    return bumpymap.open(folder / "out").tiles()


def test_tiles_of_few_points_have_a_class_with_a_wide_interval_and_no_way(tmp_path):
    tiles = mapped_meadow(tmp_path, 0.8)
    few = tiles["count"].between(4, 10)
    assert few.sum() > 100
    assert (tiles["class"][few] < 2).mean() > 0.9
    assert (tiles["c_r_high"][few] > 2 * tiles["c_r_low"][few]).all()
    assert not tiles["passable"][tiles["count"] < 11].any()
    assert tiles["class"][tiles["count"] < 4].isna().all()


@pytest.mark.parametrize(("rms", "noise", "within"), [(0.03, 0.01, 1.25), (0.01, 0.02, 2.0)])
def test_no_border_is_drawn_where_the_density_changes(tmp_path, rms, noise, within):
    tiles = mapped_meadow(tmp_path, 60.0, noise, rms, thin_east=0.1)
    column = tiles["col"] - tiles["col"].min()
    dense, thin = tiles[column.between(1, 6)], tiles[column.between(9, 14)]
    assert dense["passable"].mean() > 0.9
    ratio = thin["c_r"].median() / dense["c_r"].median()
    assert 1 / within < ratio < within
    middle = dense["c_r"].median()
    assert ((thin["c_r_low"] < middle) & (middle < thin["c_r_high"])).mean() > 0.7


def loaded(folder, **settings):
    return RatingModels.load(MapConfig((Path("a.laz"),), folder, **settings))


@pytest.mark.parametrize(("rating", "scatter"), [("ride", DRIVE_LOG_SD), ("table", 0.0)])
def test_a_map_says_by_how_much_drives_scatter_where_its_intervals_hold_it(tmp_path, rating, scatter):
    record, _ = mapped([write_survey(tmp_path / "site.las")], tmp_path / "out", "--set", f"rating={rating}")
    assert record["cost"]["drive_log_sd"] == scatter


def test_what_tiles_of_another_size_need(tmp_path):
    with pytest.raises(
        UsageError, match=r"bumpymap calibrate --vehicle warthog --tile-size 1\.5 --set pixels=15 --out my"
    ):
        loaded(tmp_path, tile_size=1.5)
    own = tmp_path / "own.json"
    own.write_text(replace(Calibration.shipped("warthog"), tile_size=1.5).to_json())
    models = loaded(tmp_path, tile_size=1.5, calibration=own)
    assert (models.texture, models.texture_id) == (None, None)
    for setting in ({"rating": "table"}, {"compat": "paper"}):
        with pytest.raises(UsageError, match=r"bumpymap train textures --set tile_size=1\.5"):
            loaded(tmp_path, tile_size=1.5, calibration=own, **setting)
    assert loaded(tmp_path).texture.tile_size == 3.0


@pytest.mark.parametrize("name", shipped_calibrations())
def test_included_vehicles_are_calibrated_for_three_sizes_with_one_meaning_of_the_classes(tmp_path, name):
    found = [loaded(tmp_path, vehicle=name, **with_pixels({"tile_size": size})).calibration for size in INCLUDED_PIXELS]
    assert [(each.tile_size, each.pixels) for each in found] == list(INCLUDED_PIXELS.items())
    assert len({each.class_limits for each in found}) == 1
    for each in found:
        assert each.tile_size / each.pixels == pytest.approx(0.2)
        assert RideModel(each).correction.origin["spearman"] > 0.94
        assert each.thin["origin"]["spearman"] > 0.7
        limits = (0.0, *each.class_limits, float("inf"))
        assert all(low <= mean < high for low, mean, high in zip(limits, each.class_c_r, limits[1:], strict=False))


def test_the_share_that_only_the_rule_of_holes_made_is_said_once(tmp_path):
    rng = np.random.default_rng(3)
    count = np.where(np.arange(100) % 4 == 0, 600, 40)  # tiles in which all pixels hold a point, or a sixth
    first = np.array([500_001.0, 4_000_002.0]) + 3.0 * np.stack(np.divmod(np.arange(100), 10), axis=1)
    corner = np.repeat(first, count, axis=0)
    points = np.column_stack([corner + rng.uniform(0.0, 3.0, corner.shape), rng.normal(0.0, 0.01, len(corner))])
    survey = write_las(tmp_path / "a.las", *points.T, crs=None)
    said = run("map", survey, "--out", tmp_path / "paper", "--local", "--set", "compat=paper").stdout
    table = pq.read_table(tmp_path / "paper" / "tiles.parquet")
    judged = np.array(table["coverage"]) >= 0.7
    counts = json.loads((tmp_path / "paper" / "run.json").read_text(encoding="utf-8"))["counts"]
    assert counts["by_holes"] == (~judged).sum() == 75
    assert said.count("compat='paper': 75.0% of the tiles are class 3") == 1
    assert (np.array(table["class"])[~judged] == 3).all()


CORNER = np.array([500_013.0, 4_000_020.0, 300.0])
"""Not a corner of a block, so that files and blocks overlap anyhow."""
SPAN = (110.0, 56.0)
"""Some three by two blocks of 48 m."""
OF_THE_CALL = {"surveys", "out", "scratch"}


@pytest.fixture(scope="module")
def points():
    """Rough ground under bushes, on a grid of 1 mm, with points that occur twice; x, y, z, class."""
    rng = np.random.default_rng(0)
    n = 28_000
    x, y = rng.uniform(0, SPAN[0], n), rng.uniform(0, SPAN[1], n)
    bush = rng.random(n) < 0.3
    z = 0.1 * x + 0.8 * np.sin(5 * x) * (x > 60) + 0.01 * rng.normal(size=n) + bush * rng.uniform(0, 2, n)
    cloud = np.column_stack([np.round(x, 3), np.round(y, 3), np.round(z, 3), np.where(bush, 5, 2)])
    return np.concatenate([cloud, cloud[:500]])


def colours(points):
    """Colours of points, 8 bits a channel, (n, 3): smooth over the ground, and darker below; a few points have none."""
    x, y, z = points[:, :3].T
    shade = np.clip(0.6 + 0.1 * (z - 0.1 * x), 0.3, 1.0)[:, None]
    found = np.rint(shade * np.column_stack([40 + x, 90 + y, 200 - x])).astype(int)
    return np.where((points[:, :1] * 1000 % 50 < 1), 0, found)


def write_parts(path, points, offset, bits=16):
    """Write points, with colours of 16 bits, or of 8 in the same fields."""
    kind = points[:, 3].astype(np.uint8)
    rgb = dict(zip(("red", "green", "blue"), colours(points).T * (257 if bits == 16 else 1), strict=True))
    return write_las(path, *(points[:, :3] + CORNER).T, offset=offset, classification=kind, **rgb)


def map_files(files, out, *options):
    with alike_surveys():
        run("map", *files, "--out", out, *options, code=0)
    content = files_in(out)
    assert set(content) == {*PRODUCT_NAMES, MapFile.PHOTO, *SIDES}
    del content["run.json"]
    record = json.loads((out / "run.json").read_text())
    record["files"] = [file for file in record["files"] if file["path"] != "item.json"]  # it names the survey
    settings_of_the_map = {name: value for name, value in record["settings"].items() if name not in OF_THE_CALL}
    kept = {name: value for name, value in record.items() if name not in {"inputs", "seconds", "settings"}}
    return content, kept | {"settings": settings_of_the_map}


@pytest.fixture(scope="module")
def whole(points, tmp_path_factory):
    """What one LAZ file gives that fits into memory, for each way to choose points."""
    folder = tmp_path_factory.mktemp("whole")
    survey = write_parts(folder / "a.laz", points, CORNER)
    found = {ground: map_files([survey], folder / ground, "--ground", ground) for ground in ("auto", "all")}
    (auto, record), (everything, _) = found.values()
    # The property below would hold little were the two the same, or the site all of one kind.
    assert auto["rasters/roughness.tif"] != everything["rasters/roughness.tif"]
    assert sum(count > 0 for count in record["counts"]["by_class"].values()) > 1
    return found


def delivered(points, folder, rng):
    """Write the files of a delivery: how many, split at random or along an axis; return them as they are named."""
    count, axis, offsets = rng.integers(1, 6), rng.integers(3), [(400_000, 3_500_000, 0), (123_456.789, 3_900_000, 17)]
    if rng.random() < 0.5:
        points = rng.permutation(points)
    if axis == 2:
        file = rng.integers(count, size=len(points))
    else:
        file = np.minimum(points[:, axis] / SPAN[axis] * count, count - 1).astype(int)
    names = [f"{n}.{rng.choice(['las', 'laz'])}" for n in range(count)]
    paths = [
        write_parts(folder / name, points[file == n], offsets[rng.integers(2)], rng.choice([8, 16]))
        for n, name in enumerate(names)
    ]
    return [paths[number] for number in rng.permutation(count)]


@settings(max_examples=4, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**6), ground=st.sampled_from(["auto", "all"]))
def test_no_delivery_and_no_budget_changes_a_byte(points, whole, tmp_path_factory, limit_points, seed, ground):
    folder, rng = tmp_path_factory.mktemp("delivery"), np.random.default_rng(seed)
    files = delivered(points, folder, rng)
    ranges = {"chunk": (2_000, 60_000), "waiting": (8_000, 80_000), "block": (5_000, 40_000)}
    limit_points(**{name: int(rng.integers(*bounds)) for name, bounds in ranges.items()})
    options = ("--ground", ground, "--threads", rng.integers(1, 4), "--set", f"scratch={folder / 'scratch'}")
    content, record = map_files(files, folder / "layers", *options)
    wanted, wanted_record = whole[ground]
    assert [name for name in wanted if content[name] != wanted[name]] == []
    assert record == wanted_record
    assert list(Path(folder / "scratch").iterdir()) == []


def test_the_photo_shows_the_highest_coloured_point_of_each_pixel(points, whole, tmp_path):
    """Bushes too, from whatever points the ground is measured; JPEG changes the colours a little."""
    (tmp_path / "photo.tif").write_bytes(whole["auto"][0][MapFile.PHOTO])
    assert whole["all"][0][MapFile.PHOTO] == whole["auto"][0][MapFile.PHOTO]
    with rasterio.open(tmp_path / "photo.tif") as file:
        photo, mask, profile, place = file.read(), file.dataset_mask() > 0, file.profile, file.transform
    assert (profile["compress"], profile["count"], place.a) == ("jpeg", 3, 0.2)
    rgb, millimetres = colours(points), np.rint((points[:, :2] + CORNER[:2]) * 1000).astype(int)
    corner = np.array([place.c, place.f - 0.2 * len(mask)])
    col, up = (millimetres // 200 - np.rint(corner / 0.2).astype(int)).T
    wanted = np.full((3, *mask.shape), -1)
    for n in np.argsort(points[:, 2])[rgb.any(axis=1)[np.argsort(points[:, 2])]]:
        wanted[:, len(mask) - 1 - up[n], col[n]] = rgb[n]
    np.testing.assert_array_equal(mask, wanted[0] >= 0)
    assert np.abs(photo - wanted)[:, mask].mean() < 5


@pytest.mark.parametrize(("share", "written"), [(0.05, False), (0.2, True)])
def test_a_tenth_of_the_points_must_have_a_colour(points, whole, tmp_path, share, written):
    """Without a photo all other layers are the same."""
    rgb = colours(points) * 257 * (np.arange(len(points)) < share * len(points))[:, None]
    columns = dict(zip(("red", "green", "blue"), rgb.T, strict=True))
    survey = write_las(
        tmp_path / "a.laz", *(points[:, :3] + CORNER).T, classification=points[:, 3].astype(int), **columns
    )
    with alike_surveys():
        run("map", survey, "--out", tmp_path / "layers", code=0)
    found = files_in(tmp_path / "layers")
    assert (MapFile.PHOTO in found) == written
    layers = [name for name in PRODUCT_NAMES if name.endswith(".tif") or name == MapFile.TILES]
    assert [name for name in layers if found[name] != whole["auto"][0][name]] == []


# ---- wherever it lies ----


SIDE_M = 42.0
"""Of the site, m: one block of 48 m holds it, or it lies across four."""


@pytest.fixture(scope="module")
def site():
    """A slope with boulders, bushes, a wall, a ditch and a hole, in one half with many points and in one with few.

    The points are half a millimetre off the borders of pixels; x, y, z and class.
    """
    rng = np.random.default_rng(7)
    x, y = rng.uniform(0, SIDE_M, (2, 60_000))
    kept = (x < SIDE_M / 2) | (rng.random(len(x)) < 0.08)
    kept &= np.hypot(x - 30, y - 8) > 3.0
    x, y = (np.floor(1000 * values[kept]) / 1000 + 0.0005 for values in (x, y))
    z = 0.15 * x + 0.05 * np.sin(1.3 * x) * np.cos(1.1 * y) + 0.01 * rng.normal(size=len(x))
    for east, north, radius in rng.uniform((0, 0, 0.3), (SIDE_M, SIDE_M, 1.2), (60, 3)):
        z += 0.7 * np.sqrt(np.maximum(0.0, radius**2 - (x - east) ** 2 - (y - north) ** 2))
    wall = (np.abs(y - 20 - 0.3 * x) < 0.2) & (x < 30)
    z += 1.5 * wall - 0.8 * (np.abs(x - 12 - 0.2 * y) < 0.6)
    bush = rng.random(len(x)) < 0.1 * (y > 30)
    z += bush * rng.uniform(0, 1.5, len(x))
    return np.column_stack([x, y, np.round(z, 3), np.where(wall | bush, 5, 2)])


def mapped_at(folder, points, corner, *options):
    """Map points with their south-west corner at a place; return columns and rasters."""
    name = "_".join(f"{number:.0f}" for number in corner)
    offset = np.add(corner, (0.0005, 0.0005, 0.0))
    survey = write_las(folder / f"{name}.laz", *(points[:, :3] + corner).T, crs=None, offset=offset,
                       classification=points[:, 3].astype(np.uint8))  # fmt: skip
    out = folder / name
    run("map", survey, "--out", out, "--local", "--overwrite", *options, code=0)
    table = pq.read_table(out / "tiles.parquet").drop_columns(["col", "row", "geometry", "bbox"])
    rasters = {path.name: rasterio.open(path).read() for path in sorted((out / "rasters").glob("*.tif"))}
    return {name: flat(table[name].combine_chunks()) for name in table.column_names}, rasters


def flat(values):
    """Values of a column; those of the maps of all tiles in one array."""
    while pa.types.is_list(values.type) or pa.types.is_fixed_size_list(values.type):
        values = values.flatten()
    return values.to_numpy(zero_copy_only=False)


BESIDE_A_BLOCK = np.array([48_000.0 + 3.0, 96_000.0 + 3.0, 100.0])
"""One tile off the corner of a block, which holds the site."""


@pytest.fixture(scope="module")
def alone(site, tmp_path_factory):
    """What the site gives in one block, for each way to choose points."""
    folder = tmp_path_factory.mktemp("alone")
    found = {ground: mapped_at(folder, site, BESIDE_A_BLOCK, "--ground", ground) for ground in ("auto", "all")}
    for table, rasters in found.values():
        assert len(np.unique(table["barred"].astype(str))) > 2
        assert 0.02 < (rasters["obstacle.tif"] == 1).mean() < 0.5
    return found


@pytest.mark.parametrize(("ground", "tiles"), [("auto", (7, 9)), ("all", (13, 0)), ("auto", (100_001, 500_001))])
def test_moved_by_whole_tiles_and_cut_into_other_blocks_it_has_the_same_bits(site, alone, tmp_path, ground, tiles):
    table, rasters = mapped_at(tmp_path, site, BESIDE_A_BLOCK + 3.0 * np.array([*tiles, 0]), "--ground", ground)
    own, own_rasters = alone[ground]
    for mine, theirs in ((own, table), (own_rasters, rasters)):
        assert mine.keys() == theirs.keys()
        for name, values in mine.items():
            np.testing.assert_array_equal(theirs[name], values, err_msg=name)


def test_raised_it_is_as_rough_to_the_last_digits_of_its_heights(site, alone, tmp_path):
    """In single precision, heights above 128 m have one digit less than those of the site."""
    table, rasters = mapped_at(tmp_path, site, BESIDE_A_BLOCK + np.array([0.0, 0.0, 137.25]), "--ground", "all")
    own, own_rasters = alone["all"]
    for name in ("class.tif", "barred.tif", "reason.tif", "obstacle.tif", "passage.tif"):
        np.testing.assert_array_equal(rasters[name], own_rasters[name], err_msg=name)
    for name in ("c_r", "p_fail", "slope", "ransac_residual", "z_variance", "relief"):
        np.testing.assert_allclose(table[name], own[name], rtol=1e-3, atol=1e-4, err_msg=name)
    np.testing.assert_allclose(rasters["heightmap.tif"] - 137.25, own_rasters["heightmap.tif"], atol=1e-4)


@pytest.mark.parametrize(("ground", "way"), [("auto", "mirrored"), ("all", "turned")])
def test_mirrored_or_turned_it_is_as_rough(site, alone, tmp_path, ground, way):
    """What is found from north to south and from west to east in turns may differ in a tile."""
    x, y = (site[:, axis] for axis in (0, 1))
    places = (SIDE_M - x, y) if way == "mirrored" else (SIDE_M - y, x)
    table, rasters = mapped_at(tmp_path, np.column_stack([*places, site[:, 2:]]), BESIDE_A_BLOCK, "--ground", ground)
    own, own_rasters = alone[ground]
    back = (lambda image: image[:, ::-1]) if way == "mirrored" else (lambda image: np.rot90(image, -1))
    band = rasters["class.tif"][0]
    assert (back(band) != own_rasters["class.tif"][0]).sum() <= 2
    ride, own_ride = back(rasters["roughness.tif"][0]), own_rasters["roughness.tif"][0]
    known = np.isfinite(ride) & np.isfinite(own_ride)
    assert known.mean() > 0.9
    assert np.abs(np.quantile(ride[known] / own_ride[known], [0.05, 0.95]) - 1.0).max() < 0.01
    for name, rtol in (("z_variance", 1e-6), ("slope", 1e-2), ("ransac_residual", 1e-2)):
        np.testing.assert_allclose(np.nansum(table[name]), np.nansum(own[name]), rtol=rtol)
