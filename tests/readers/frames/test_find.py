"""Frames come in the order of time, from files and from folders of data sets."""

from pathlib import Path

import pytest

from bumpymap.core.errors import BadInputError
from bumpymap.readers import find_frames


def fill(folder, *names):
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_bytes(b"x")
    return folder


def names(paths):
    return [path.name for path in paths]


def test_numbers_in_names_count_as_numbers(tmp_path):
    folder = fill(tmp_path / "drive", "frame10.bin", "frame9.bin", "frame100.bin", ".hidden.bin", "poses.txt")
    assert names(find_frames([folder])) == ["frame9.bin", "frame10.bin", "frame100.bin"]


def test_a_named_file_may_have_any_ending(tmp_path):
    fill(tmp_path, "scan.dat")
    assert names(find_frames([tmp_path / "scan.dat"])) == ["scan.dat"]


@pytest.mark.parametrize("inside", ["velodyne", "os1_cloud_node_kitti_bin"])
def test_a_sequence_of_a_data_set_is_found(tmp_path, inside):
    fill(tmp_path / "04" / inside, "1.bin", "0.bin")
    fill(tmp_path / "04" / "labels", "0.label")
    assert names(find_frames([tmp_path / "04"])) == ["0.bin", "1.bin"]


def test_what_cannot_be_taken_is_refused(tmp_path):
    with pytest.raises(BadInputError, match="no scan was given"):
        find_frames([])
    with pytest.raises(BadInputError, match="does not exist"):
        find_frames([tmp_path / "none"])
    with pytest.raises(BadInputError, match="holds no scans"):
        find_frames([fill(tmp_path / "texts", "a.txt")])
    with pytest.raises(BadInputError, match="several formats"):
        find_frames([fill(tmp_path / "mixed", "a.bin", "a.ply")])
    with pytest.raises(BadInputError, match="neither"):
        find_frames([Path("/dev/null")])
