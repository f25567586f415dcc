"""Folders that are refused: no complete run, damaged files, maps of an earlier version."""

import json

import pytest
from route_maps import copy_folder, write_folder

from bumpymap.core import BadInputError
from bumpymap.layers import open_map
from bumpytiles import Grid

SMALL = Grid(3.0, 4)


@pytest.fixture(scope="module")
def small(make_field, tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("route") / "small", make_field(20, 16, grid=SMALL))


def test_what_is_no_complete_run_is_refused(small, tmp_path):
    with pytest.raises(BadInputError, match="there is no folder"):
        open_map(tmp_path / "none")
    half = copy_folder(small, tmp_path / "half")
    (half / "run.json").unlink()
    with pytest.raises(BadInputError, match="no complete run"):
        open_map(half)


@pytest.mark.parametrize("name", ["cost.tif", "rasters/heightmap.tif"])
def test_missing_cut_off_and_damaged_files_are_refused(small, tmp_path, name):
    folder = copy_folder(small, tmp_path / "layers")
    path = folder / name
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    with pytest.raises(BadInputError, match=f"{name} is cut off"):
        open_map(folder)
    path.unlink()
    with pytest.raises(BadInputError, match=f"{name} is missing"):
        open_map(folder)
    path.write_bytes(content[:-400] + bytes(400))
    if name == "rasters/heightmap.tif":  # compared by size only
        return
    with pytest.raises(BadInputError, match=f"{name} is damaged"):
        open_map(folder)


def test_rasters_of_another_place_are_refused(small, tmp_path, make_field):
    """A raster that was copied from another run; its size and checksum are entered, so only its place is wrong."""
    folder = copy_folder(small, tmp_path / "layers")
    other = write_folder(tmp_path / "other", make_field(20, 17, grid=SMALL))
    record, others = (json.loads((each / "run.json").read_text()) for each in (folder, other))
    (folder / "cost.tif").write_bytes((other / "cost.tif").read_bytes())
    kept = [entry for entry in record["files"] if entry["path"] != "cost.tif"]
    record["files"] = kept + [entry for entry in others["files"] if entry["path"] == "cost.tif"]
    (folder / "run.json").write_text(json.dumps(record))
    with pytest.raises(BadInputError, match=r"cost\.tif spans other tiles"):
        open_map(folder)
    record["grid"]["tile_size_m"] = 2.5
    (folder / "run.json").write_text(json.dumps(record))
    with pytest.raises(BadInputError, match="does not lie on the grid"):
        open_map(folder)


@pytest.mark.parametrize("key", ["grid", "files", "crs"])
def test_a_damaged_manifest_is_refused(small, tmp_path, key):
    folder = copy_folder(small, tmp_path / "layers", **{key: {"a": 1}})
    with pytest.raises(BadInputError, match=r"run\.json is damaged"):
        open_map(folder)


def test_a_map_in_sheets_of_an_earlier_version_is_refused(tmp_path):
    (tmp_path / "county" / "sheets").mkdir(parents=True)
    (tmp_path / "county" / "run.json").write_text(json.dumps({"format": "bumpymap-sheets", "sheets": []}))
    with pytest.raises(BadInputError, match=r"county holds a map of another version.*Map the survey again"):
        open_map(tmp_path / "county")


def test_a_map_of_the_first_version_is_refused(small, tmp_path):
    """It had all files at the top."""
    folder = copy_folder(small, tmp_path / "layers", version=1)
    for path in (folder / "rasters").iterdir():
        path.rename(folder / path.name)
    with pytest.raises(BadInputError, match=r"layers holds a map of another version.*other places.*again"):
        open_map(folder)
