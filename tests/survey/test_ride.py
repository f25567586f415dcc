"""The ride of a map: at another speed, by heading, of few points, in tiles of other sizes, by the paper's rules."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import rasterio
from scipy.ndimage import map_coordinates
from small_surveys import files_in, run, write_las

import bumpymap
from bumpymap.core import INCLUDED_PIXELS, MapConfig, UsageError, with_pixels
from bumpymap.lab.terrains import fractal
from bumpymap.layers import open_map
from bumpymap.rating import Calibration, RideModel
from bumpymap.rating.calibration import shipped_calibrations
from bumpymap.survey.tile_rating import RatingModels

pytestmark = pytest.mark.slow


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
    """The map, the map with the ride by heading, and that at 2 m/s."""
    out = tmp_path_factory.mktemp("maps")
    wanted = {"plain": (), "headings": ("--set", "headings=true"), "fast": ("--speed", 2)}
    for name, options in wanted.items():
        run("map", survey, "--out", out / name, *options, code=0)
    return out


def bands(path):
    with rasterio.open(path) as file:
        return dict(zip(file.descriptions, file.read(), strict=True))


def test_the_other_layers_keep_their_bytes(maps):
    plain, more = (files_in(maps / name) for name in ("plain", "headings"))
    same = [name for name in plain if name.endswith(".tif")]
    assert len(same) == 10
    assert all(plain[name] == more[name] for name in same)


def test_c_r_by_heading_has_the_mean_of_the_tile_which_is_all_that_few_points_tell(maps):
    found, site = bands(maps / "headings" / "rasters/headings.tif"), open_map(maps / "headings")
    assert tuple(found) == tuple(f"c_r_{azimuth:g}" for azimuth in np.arange(8) * 22.5)
    by_axis, tiles = np.stack(list(found.values()), axis=-1), bands(maps / "headings" / "rasters/roughness.tif")
    np.testing.assert_array_equal(by_axis, site.headings(site.window))
    c_r, dense = tiles["c_r"], tiles["coverage"] > 0.75
    counts = np.diff(RideModel(Calibration.shipped("warthog")).operator.axes.bounds)
    np.testing.assert_allclose(np.average(by_axis, axis=2, weights=counts), c_r, rtol=1e-5)
    thin = np.isfinite(c_r) & (tiles["coverage"] < 0.35)
    assert thin.sum() > 10
    np.testing.assert_array_equal(by_axis[thin], np.repeat(c_r[thin][:, None], 8, axis=1))
    assert np.median(by_axis[dense].max(axis=1) / by_axis[dense].min(axis=1)) > 1.1
    table = pq.read_table(maps / "headings" / "tiles.parquet", columns=["calm_axis_deg", "heading_ratio"]).to_pandas()
    flat = by_axis[np.isfinite(c_r)]
    assert sorted(table.heading_ratio.dropna()) == pytest.approx(sorted(flat.max(axis=1) / flat.min(axis=1)), rel=1e-5)
    assert (table.calm_axis_deg.dropna() == 22.5 * np.round(table.calm_axis_deg.dropna() / 22.5)).all()
    assert not open_map(maps / "plain").has_headings
    assert not {"calm_axis_deg", "heading_ratio"} & set(pq.read_schema(maps / "plain" / "tiles.parquet").names)


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
