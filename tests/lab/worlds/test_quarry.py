"""The generator of the sample survey: the truth that the survey is held to, and its files byte by byte."""

import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest
from made_quarry import (
    CROWN,
    KERB_HEIGHT,
    NOISE_POINTS,
    NOISE_SIGMA,
    RAMP_SLOPE_DEG,
    STRAYS,
    WASHBOARD_AMPLITUDE,
    WASHBOARD_LENGTH,
    WITHHELD_POINTS,
    QuarrySite,
    is_true_ground,
    sample_survey,
)
from ply_files import read_vertices

ROOT = Path(__file__).resolve().parents[3]
SITE = QuarrySite(1)
WEST, SOUTH = SITE.bounds.west, SITE.bounds.south


@pytest.fixture(scope="module")
def points():
    return sample_survey(SITE, density=20.0)


def off_the_ground(points):
    return points["upward"] - SITE.height(points["easting"], points["northing"])


def tile_lattice(col, row, steps=40):
    inner = (np.arange(steps) + 0.5) * 3.0 / steps
    return np.meshgrid(col * 3.0 + inner, row * 3.0 + inner)


def residual_deviation(col, row):
    east, north = (axis.ravel() for axis in tile_lattice(col, row))
    z = SITE.height(east, north)
    design = np.column_stack((east - col * 3.0, north - row * 3.0, np.ones(z.size)))
    return np.std(z - design @ np.linalg.lstsq(design, z, rcond=None)[0])


def test_the_ground_is_continuous_but_for_the_kerb():
    draw = np.random.default_rng(3).random((2, 40_000))
    east, north, step = WEST + 126.0 * draw[0], SOUTH + 102.0 * draw[1], 1e-4
    assert np.abs(SITE.height(east + step, north) - SITE.height(east, north)).max() < 10.0 * step


def test_ramp_is_exactly_a_plane_of_its_slope():
    col, row = SITE.tiles_inside("ramp")
    assert col.size >= 20
    for c, r in zip(col[::3], row[::3], strict=True):
        rise = np.gradient(SITE.height(*tile_lattice(c, r)), 3.0 / 40)
        assert np.degrees(np.arctan(rise[0])) == pytest.approx(np.full(rise[0].shape, RAMP_SLOPE_DEG), abs=1e-6)
        assert np.abs(rise[1]).max() < 1e-9


def test_kerb_washboard_and_crown_have_their_sizes():
    middle, out = np.array([67.4, 67.4]), np.array([-1e-4, 1e-4])
    z = SITE.height(WEST + middle, SOUTH + 44.3 - out)
    assert z[0] - z[1] == pytest.approx(KERB_HEIGHT, abs=1e-5)
    x = 50.0 + np.arange(0.0, 40 * WASHBOARD_LENGTH, WASHBOARD_LENGTH / 20.0)[:800]
    centre = 26.0 + 4.0 * np.sin(2.0 * np.pi * (x - 10.0) / 140.0)
    z, phase = SITE.height(WEST + x, SOUTH + centre), 2.0 * np.pi * x / WASHBOARD_LENGTH
    left = z - np.polynomial.Polynomial.fit(x, z, 5)(x)
    amplitude = 2.0 * np.hypot(np.mean(left * np.sin(phase)), np.mean(left * np.cos(phase)))
    assert amplitude == pytest.approx(WASHBOARD_AMPLITUDE, rel=0.05)
    centre = 26.0 + 4.0 * np.sin(2.0 * np.pi * 15.0 / 140.0)
    south, top, north = SITE.height(np.full(3, WEST + 25.0), SOUTH + centre + np.array([-5.5, 0.0, 5.5]))
    assert top - (south + north) / 2.0 == pytest.approx(CROWN * 5.5, abs=0.03)


def test_zones_hold_whole_tiles_and_are_as_rough_as_their_names():
    zones = ("pad", "road", "washboard", "ruts", "rubble", "bank", "step", "ramp", "floor", "meadow")
    tiles = {zone: np.transpose(SITE.tiles_inside(zone)) for zone in zones}
    for zone, places in tiles.items():
        assert len(places) >= (6 if zone == "pad" else 20), zone
        assert all(np.all(SITE.zone_at(*tile_lattice(*place)) == zone) for place in places[::9])
    rough = {zone: np.median([residual_deviation(*place) for place in places[::4]]) for zone, places in tiles.items()}
    assert max(rough["ramp"], rough["pad"]) < 1e-9
    assert 0.0 < rough["road"] < rough["floor"] < rough["washboard"] < rough["ruts"] < rough["rubble"] < rough["bank"]
    assert rough["ruts"] < rough["step"] < rough["rubble"]


def test_heights_are_the_reliefs_within_the_noise(points):
    error = off_the_ground(points)[is_true_ground(points)]
    assert abs(error.mean()) < 5.0 * NOISE_SIGMA / np.sqrt(error.size)
    assert error.std() == pytest.approx(NOISE_SIGMA, rel=0.01)
    assert np.abs(error).max() < 6.0 * NOISE_SIGMA


def test_errors_are_counted_and_far_from_the_ground(points):
    off, stray, class_id = off_the_ground(points), points["is_stray"], points["classification"]
    assert (np.count_nonzero(off[stray] > 15.0), np.count_nonzero(off[stray] < -10.0)) == (5, STRAYS - 5)
    assert set(class_id[stray].tolist()) == {1, 2}
    assert np.count_nonzero(class_id == 7) == NOISE_POINTS
    assert np.abs(off[class_id == 7]).min() > 2.9
    assert points["withheld"].sum() == WITHHELD_POINTS
    assert np.abs(off[points["withheld"]]).min() > 0.25


def test_pond_is_the_only_hole_and_trees_stand_over_thinner_ground(points):
    assert not SITE.is_water(points["easting"], points["northing"]).any()
    edges = (np.arange(WEST + 3.0, WEST + 123.1, 3.0), np.arange(SOUTH + 3.0, SOUTH + 99.1, 3.0))
    counts, _, _ = np.histogram2d(points["easting"], points["northing"], bins=edges)
    col, row = np.nonzero(counts == 0)
    assert SITE.is_water(edges[0][col] + 1.5, edges[1][row] + 1.5).all()
    tree = SITE.trees[0]
    under = np.hypot(points["easting"] - tree.easting, points["northing"] - tree.northing) < tree.radius * 0.99
    canopy = under & (points["classification"] == 5)
    assert np.count_nonzero(canopy) > np.count_nonzero(under & is_true_ground(points)) > 0
    assert 0.0 < (points["upward"][canopy] - SITE.height(tree.easting, tree.northing)).max() <= tree.height + 1e-3


@pytest.mark.later
def test_the_sample_files_are_what_the_generator_makes(tmp_path):
    # Sines may differ in the last bit between machines, so a height may round to the next millimetre.
    command = [sys.executable, str(ROOT / "tests" / "worlds" / "made_quarry.py"), "--out", str(tmp_path)]
    subprocess.run(command, check=True)
    for read, name in ((laspy.read, "quarry.laz"), (read_vertices, "quarry_part.ply")):
        stored, made = read(ROOT / "sample_data" / name), read(tmp_path / name)
        assert np.array_equal(stored["classification"], made["classification"])
        for axis in "xyz":
            off = np.abs(np.asarray(stored[axis]) - np.asarray(made[axis]))
            assert np.mean(off > 1e-6) < 1e-4
            assert np.quantile(off, 0.9999) < 1.1e-3
    text = (ROOT / "sample_data" / "README.md").read_text(encoding="utf-8")
    assert all(f"`{path.name}`" in text for path in (ROOT / "sample_data").iterdir() if path.name != "README.md")
