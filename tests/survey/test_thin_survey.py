"""Surveys of few points a tile: the ride is known from them and their neighbours, and what stands there is not."""

import numpy as np
from small_surveys import run, write_las

import bumpymap

SIDE = 48.0


def mapped(folder, density, noise=0.01):
    """Map a level meadow without classes; return its tiles."""
    rng = np.random.default_rng(11)
    x, y = rng.uniform(0.0, SIDE, (2, int(density * SIDE**2)))
    write_las(
        folder / "meadow.las", 500_000 + x, 4_000_000 + y, rng.normal(0.0, noise, len(x)),
        crs="EPSG:32614", offset=(500_000, 4_000_000, 0),
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
