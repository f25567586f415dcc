"""The generator of the sample survey: the truth that the survey is held to, and its files byte by byte."""

import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest
from made_quarry import (
    NOISE_SIGMA,
    QuarrySite,
    is_true_ground,
    sample_survey,
)
from ply_files import read_vertices

ROOT = Path(__file__).resolve().parents[3]
SITE = QuarrySite(1)


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
