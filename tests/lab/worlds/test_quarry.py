"""The site of the sample survey: its zones, and the files of the survey, which are held against its relief."""

from pathlib import Path

import laspy
import made_quarry
import numpy as np
import pytest
from ply_files import read_vertices

SAMPLES = Path(__file__).resolve().parents[3] / "sample_data"


def residual_deviation(col, row):
    inner = (np.arange(40) + 0.5) * 3.0 / 40
    east, north = (axis.ravel() for axis in np.meshgrid(col * 3.0 + inner, row * 3.0 + inner))
    z = made_quarry.height(east, north)
    design = np.column_stack((east - col * 3.0, north - row * 3.0, np.ones(z.size)))
    return np.std(z - design @ np.linalg.lstsq(design, z, rcond=None)[0])


def test_zones_of_the_page_are_as_rough_as_their_names():
    """The symbols on the map of the page: pad, ramp, road, floor, washboard, ruts, step, rubble, bank."""
    pad, ramp, road, floor, washboard, ruts, step, rubble, bank = (
        np.median([residual_deviation(*place) for place in np.transpose(made_quarry.tiles_of(symbol))[::4]])
        for symbol in "P/RfWUSXB"
    )
    assert max(pad, ramp) < 1e-9
    assert 0.0 < road < floor < washboard < ruts < step < rubble < bank


@pytest.mark.parametrize(("read", "name"), [(laspy.read, "quarry.laz"), (read_vertices, "quarry_part.ply")])
def test_heights_of_the_sample_files_are_the_reliefs_within_the_noise(read, name):
    points = read(SAMPLES / name)
    if name == "quarry.laz":
        points = points[np.asarray(points["withheld"]) == 0][::4]
    ground = np.asarray(points["classification"]) == 2
    x, y, z = (np.asarray(points[axis], float)[ground] for axis in "xyz")
    error = z - made_quarry.height(x, y)
    stray = np.abs(error) > 10.0
    assert stray.sum() <= 4
    error = error[~stray]
    assert abs(error.mean()) < 5.0 * 0.008 / np.sqrt(error.size)
    assert error.std() == pytest.approx(0.008, rel=0.01)
    assert np.abs(error).max() < 6.0 * 0.008
    assert not made_quarry.is_water(x, y).any()


def test_the_page_of_the_samples_names_them_all():
    text = (SAMPLES / "README.md").read_text(encoding="utf-8")
    assert all(f"`{path.name}`" in text for path in SAMPLES.iterdir() if path.name != "README.md")
