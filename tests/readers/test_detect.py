import shutil

import numpy as np
import pytest

from bumpymap.core.errors import BadInputError
from bumpymap.readers import open_survey


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n", "git lfs pull"),
        (b"PK\x03\x04" + bytes(50), "ZIP"),
        (b"\x89MCAP0\r\n" + bytes(50), "a bag of ROS 2, which bumpymap scan reads"),
        (b"SQLite format 3\0" + bytes(50), "If it is a bag"),
        (b"#ROSBAG V2.0\n" + bytes(50), "rosbags-convert"),
        (b"\x1f\x8b\x08" + bytes(50), "gzip"),
        (b"ASTM-E57" + bytes(50), "E57"),
        (b"<!DOCTYPE html><title>404</title>", "HTML"),
        (b"1.0 2.0 3.0\n4.0 5.0 6.0\n", "text file"),
        (b"plyers of the sea\n", "text file"),
        (bytes(5000), "zero bytes"),
        (b"\x89PNG\r\n\x1a\n" + bytes(50), "of an unknown kind .first bytes 89 50 4e"),
    ],
)
@pytest.mark.parametrize("name", ["a.laz", "a.ply", "a.pcd", "a"])
def test_what_is_no_point_cloud_is_named(tmp_path, content, says, name):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(BadInputError, match=says):
        open_survey(path)


def test_content_counts_and_not_the_ending(las, read, tmp_path):
    path = tmp_path / "really.ply"
    shutil.copy(las.write("a.laz"), path)
    reader = open_survey(path)
    assert reader.info.format.startswith("LAZ")
    assert np.array_equal(read(reader)[0], las.points)


def test_what_cannot_be_opened(tmp_path):
    with pytest.raises(BadInputError, match="cannot read"):
        open_survey(tmp_path)
    with pytest.raises(BadInputError, match="No such file"):
        open_survey(tmp_path / "nowhere.las")
