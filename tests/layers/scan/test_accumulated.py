"""gathered.laz: points of the frames in the frame of the world."""

import laspy
import numpy as np
from pyproj import CRS
from scipy.spatial.transform import Rotation

from bumpymap.layers import open_accumulated


def pose(turn, place):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn.as_matrix(), place
    return matrix


def test_points_are_written_where_they_are_with_their_classes(tmp_path):
    rng = np.random.default_rng(1)
    first = np.array([500_000.25, 4_000_000.5, 321.0])
    world, ground = first + rng.uniform(-80.0, 80.0, (500, 3)), rng.uniform(size=500) < 0.5
    path = tmp_path / "a.laz"
    with open_accumulated(path, pose(Rotation.identity(), first), CRS.from_epsg(32614)) as gathered:
        gathered.add_points(world[:200], ground[:200])
        gathered.add_points(world[:0], ground[:0])
        gathered.add_points(world[200:], ground[200:])
    las = laspy.read(path)
    assert las.header.parse_crs().to_epsg() == 32614
    np.testing.assert_allclose(las.xyz, world, atol=0.00051)
    np.testing.assert_array_equal(las.classification, np.where(ground, 2, 1))
    np.testing.assert_allclose(las.header.mins, world.min(axis=0), atol=0.00051)


def test_without_a_crs_the_file_has_none_and_the_same_points_give_the_same_bytes(scan, tmp_path):
    for name in ("a.laz", "b.laz"):
        with open_accumulated(tmp_path / name, np.eye(4), None) as gathered:
            gathered.add_points(scan.points.astype(float), scan.points[:, 2] < 0.0)
    assert laspy.open(tmp_path / "a.laz").header.parse_crs() is None
    assert (tmp_path / "a.laz").read_bytes() == (tmp_path / "b.laz").read_bytes()
