"""Folders that are refused: no complete run, damaged files, maps that cannot be compared."""

import json
from dataclasses import replace

import pytest
from pyproj import CRS
from route_maps import VEHICLE, copy_folder, write_folder

from bumpymap.core import BadInputError, Georeference, OutputError
from bumpymap.layers import check_folder, open_map, open_pair
from bumpytiles import Grid

SMALL = Grid(3.0, 4)


@pytest.fixture(scope="module")
def small(make_field, tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("route") / "small", make_field(20, 16, grid=SMALL))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"vehicle": VEHICLE | {"name": "rover"}}, "vehicle is warthog and rover"),
        ({"vehicle": VEHICLE | {"speed_mps": 2.0}}, "speed"),
        ({"calibration": {"id": "beef", "vehicle": "warthog"}}, "calibration is c0ffee and beef"),
        ({"settings": {"rating": "table", "compat": "none"}}, "rating is ride and table"),
    ],
)
def test_layers_of_two_vehicles_are_not_compared(small, tmp_path, changes, words):
    first, second = small, copy_folder(small, tmp_path / "two", **changes)
    with pytest.raises(BadInputError, match=words) as caught:
        open_pair(first, second)
    assert str(first) in str(caught.value)
    assert str(second) in str(caught.value)


def test_other_grids_and_crs_are_not_compared(small, make_field, tmp_path):
    made = make_field(4, 3, grid=SMALL)
    first = small
    other = write_folder(tmp_path / "two", make_field(4, 3, grid=Grid(3.0, 5)))
    with pytest.raises(BadInputError, match="pixels along a tile is 4 and 5"):
        open_pair(first, other)
    north = write_folder(tmp_path / "three", replace(made, georeference=Georeference(CRS.from_epsg(32613))))
    with pytest.raises(BadInputError, match="UTM zone 14N and WGS 84 / UTM zone 13N"):
        open_pair(first, north)


def test_what_is_no_complete_run_is_refused(small, tmp_path):
    with pytest.raises(BadInputError, match="there is no folder"):
        open_map(tmp_path / "none")
    half = copy_folder(small, tmp_path / "half")
    (half / "run.json").unlink()
    with pytest.raises(BadInputError, match="no complete run"):
        open_map(half)


@pytest.mark.parametrize("name", ["barred.tif", "roughness.tif", "cost.tif", "heightmap.tif", "obstacle.tif"])
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
    if name in {"heightmap.tif", "obstacle.tif"}:  # compared by size only
        return
    with pytest.raises(BadInputError, match=f"{name} is damaged"):
        open_map(folder)


def test_rasters_of_another_place_are_refused(small, tmp_path, make_field):
    """A raster that was copied from another run; its size and checksum are entered, so only its place is wrong."""
    folder = copy_folder(small, tmp_path / "layers")
    other = write_folder(tmp_path / "other", make_field(20, 17, grid=SMALL))
    record, others = (json.loads((each / "run.json").read_text()) for each in (folder, other))
    for name in ("cost.tif", "heightmap.tif"):
        (folder / name).write_bytes((other / name).read_bytes())
    entries = {entry["path"]: entry for entry in others["files"]}
    swapped = {"cost.tif", "heightmap.tif"}
    record["files"] = [entries[e["path"]] if e["path"] in swapped else e for e in record["files"]]
    (folder / "run.json").write_text(json.dumps(record))
    with pytest.raises(BadInputError, match=r"cost\.tif spans other tiles"):
        open_map(folder)
    record["grid"]["tile_size_m"] = 2.5
    (folder / "run.json").write_text(json.dumps(record))
    with pytest.raises(BadInputError, match="does not lie on the grid"):
        open_map(folder)


@pytest.mark.parametrize("key", ["grid", "cost", "files", "metres_per_unit", "crs"])
def test_a_damaged_manifest_is_refused(small, tmp_path, key):
    folder = copy_folder(small, tmp_path / "layers", **{key: {"a": 1}})
    with pytest.raises(BadInputError, match=r"run\.json is damaged"):
        open_map(folder)


def test_a_map_in_sheets_of_an_earlier_version_is_refused(small, tmp_path):
    (tmp_path / "county" / "sheets").mkdir(parents=True)
    folder = copy_folder(small, tmp_path / "county" / "sheets" / "e0001_n0002", sheet={"name": "e0001_n0002"})
    (tmp_path / "county" / "run.json").write_text(json.dumps({"format": "bumpymap-sheets", "sheets": []}))
    with pytest.raises(BadInputError, match=r"holds a map in sheets.*Give one of the folders in .*county/sheets"):
        open_map(tmp_path / "county")
    with pytest.raises(OutputError, match=r"holds a map in sheets.*Choose another `out`"):
        check_folder(tmp_path / "county", overwrite=True)
    assert open_map(folder).window == open_map(small).window
