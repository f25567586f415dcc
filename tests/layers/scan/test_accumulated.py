"""gathered.laz: points of the frames in the frame of the world."""

from contextlib import contextmanager

import laspy
import numpy as np
import pytest
from pyproj import CRS
from scipy.spatial.transform import Rotation

from bumpymap.core.errors import BadInputError, OutputError
from bumpymap.layers import open_accumulated, output_errors


def pose(turn, place):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn.as_matrix(), place
    return matrix


def test_points_are_turned_moved_and_classed(scan, classed, nothing, tmp_path):
    turns = [Rotation.from_euler("zyx", angles) for angles in ((0.3, 0.1, -0.05), (2.0, -0.2, 0.1))]
    places = [np.array([500_000.25, 4_000_000.5, 321.0]), np.array([500_010.0, 4_000_003.0, 322.0])]
    path = tmp_path / "a.laz"
    with open_accumulated(path, pose(turns[0], places[0]), CRS.from_epsg(32614)) as gathered:
        gathered.add(scan, pose(turns[0], places[0]), classed)
        gathered.add(nothing[0], np.eye(4), nothing[1])
        gathered.add(scan, pose(turns[1], places[1]), classed)
    ground = np.append(classed.sectors.traversable, False)[classed.sectors.point_sector]
    assert gathered.record() == {"points": 2 * len(scan.points), "ground": 2 * int(ground.sum())}
    las = laspy.read(path)
    assert las.header.parse_crs().to_epsg() == 32614
    expected = np.concatenate([t.apply(scan.points.astype(float)) + p for t, p in zip(turns, places, strict=True)])
    np.testing.assert_allclose(las.xyz, expected, atol=0.00051)
    np.testing.assert_array_equal(las.classification, np.where(np.concatenate([ground, ground]), 2, 1))
    np.testing.assert_allclose(las.header.mins, expected.min(axis=0), atol=0.00051)


def test_without_a_crs_the_file_has_none_and_the_same_points_give_the_same_bytes(scan, classed, tmp_path):
    for name in ("a.laz", "b.laz"):
        with open_accumulated(tmp_path / name, np.eye(4), None) as gathered:
            gathered.add(scan, np.eye(4), classed)
    assert laspy.open(tmp_path / "a.laz").header.parse_crs() is None
    assert (tmp_path / "a.laz").read_bytes() == (tmp_path / "b.laz").read_bytes()


def test_a_drive_without_points_is_a_file_without_points(tmp_path):
    with open_accumulated(tmp_path / "a.laz", np.eye(4), None):
        pass
    assert laspy.open(tmp_path / "a.laz").header.point_count == 0


def test_a_frame_on_another_continent_is_refused(scan, classed, tmp_path):
    far = pose(Rotation.identity(), [3e6, 0.0, 0.0])
    with (
        pytest.raises(BadInputError, match="more than 2,000 km"),
        open_accumulated(tmp_path / "a.laz", np.eye(4), None) as g,
    ):
        g.add(scan, far, classed)


def test_a_full_disk_is_said(scan, classed, tmp_path):
    class Full:
        """Stands for a path on a disk with little room."""

        @contextmanager
        def open(self, mode):
            with (tmp_path / "a.laz").open(mode) as stream:
                write = stream.write

                class Stream:
                    def write(self, data):
                        if stream.tell() > 20_000:
                            raise OSError(28, "No space left on device")
                        return write(data)

                    def __getattr__(self, name):
                        return getattr(stream, name)

                yield Stream()

    with pytest.raises(OutputError, match="nothing half-written"), output_errors(tmp_path):  # noqa: SIM117
        with open_accumulated(Full(), np.eye(4), None) as gathered:
            gathered.add(scan, np.eye(4), classed)
