"""Surveys of few points a tile: the ride is known from them and their neighbours, and what stands there is not."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from small_surveys import run, write_las

import bumpymap
from bumpymap.lab.worlds.terrains import fractal

SIDE = 48.0


def mapped(folder, density, noise=0.01, rms=0.0, thin_east=1.0):
    """Map a meadow without classes; return its tiles. ``thin_east``: share of the points of its eastern half."""
    rng = np.random.default_rng(11)
    x, y = rng.uniform(0.0, SIDE, (2, int(density * SIDE**2)))
    kept = (x < SIDE / 2) | (rng.random(len(x)) < thin_east)
    x, y, z = x[kept], y[kept], noise * rng.standard_normal(kept.sum())
    if rms:
        step = 0.1
        axis = np.broadcast_to(np.arange(0.0, SIDE, step), (int(SIDE / step),) * 2)
        z += map_coordinates(fractal(rng, axis, 0.5, rms), [y / step, x / step], order=1, mode="nearest")
    write_las(
        folder / "meadow.las", 500_000 + x, 4_000_000 + y, z, crs="EPSG:32614", offset=(500_000, 4_000_000, 0)
    )  # fmt: skip
    assert run("map", folder / "meadow.las", "--out", folder / "out", "--quiet").exit_code == 0
    return bumpymap.open(folder / "out").tiles()


def test_tiles_of_few_points_have_a_class_with_a_wide_interval_and_no_way(tmp_path):
    tiles = mapped(tmp_path, 0.8)
    few = tiles["count"].between(4, 10)
    assert few.sum() > 100
    assert (tiles["class"][few] < 2).mean() > 0.9
    assert (tiles["c_r_high"][few] > 2 * tiles["c_r_low"][few]).all()
    assert not tiles["passable"][tiles["count"] < 11].any()
    assert tiles["class"][tiles["count"] < 4].isna().all()


def test_more_points_make_a_way(tmp_path):
    tiles = mapped(tmp_path, 4.0)
    whole = tiles["count"] > 20
    assert (tiles["class"][whole] == 0).all()
    assert tiles["passable"][whole].mean() > 0.9


@pytest.mark.parametrize(("rms", "noise", "within"), [(0.03, 0.01, 1.25), (0.01, 0.02, 2.0)])
def test_no_border_is_drawn_where_the_density_changes(tmp_path, rms, noise, within):
    tiles = mapped(tmp_path, 60.0, noise, rms, thin_east=0.1)
    column = tiles["col"] - tiles["col"].min()
    dense, thin = tiles[column.between(1, 6)], tiles[column.between(9, 14)]
    ratio = thin["c_r"].median() / dense["c_r"].median()
    assert 1 / within < ratio < within
    middle = dense["c_r"].median()
    assert ((thin["c_r_low"] < middle) & (middle < thin["c_r_high"])).mean() > 0.7
