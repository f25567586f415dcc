"""gathered.laz: points of the frames in the frame of the world."""

import laspy
import numpy as np
import pytest
from pyproj import CRS

from bumpymap.layers import open_accumulated


@pytest.mark.parametrize("crs", [CRS.from_epsg(32614), None])
def test_points_are_written_where_they_are_with_their_classes(tmp_path, crs):
    rng = np.random.default_rng(1)
    first = np.eye(4)
    first[:3, 3] = 500_000.25, 4_000_000.5, 321.0
    world, ground = first[:3, 3] + rng.uniform(-80.0, 80.0, (500, 3)), rng.uniform(size=500) < 0.5
    for name in ("a.laz", "b.laz"):
        with open_accumulated(tmp_path / name, first, crs) as gathered:
            gathered.add_points(world[:200], ground[:200])
            gathered.add_points(world[:0], ground[:0])
            gathered.add_points(world[200:], ground[200:])
    assert (tmp_path / "a.laz").read_bytes() == (tmp_path / "b.laz").read_bytes()
    las = laspy.read(tmp_path / "a.laz")
    assert las.header.parse_crs() == crs
    np.testing.assert_allclose(las.xyz, world, atol=0.00051)
    np.testing.assert_array_equal(las.classification, np.where(ground, 2, 1))
    np.testing.assert_allclose(las.header.mins, world.min(axis=0), atol=0.00051)
