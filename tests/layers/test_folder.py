import hashlib
import json
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pyogrio
import pytest
import rasterio
from cost_maps import part_of
from small_surveys import SIDES, files_in

from bumpymap.core import SilentProgress
from bumpymap.core.errors import BadInputError, OutputError
from bumpymap.core.types import CostTable, Georeference
from bumpymap.layers import check_extent, check_folder, software_versions, write_products
from bumpymap.layers.placement import MAX_TILES
from bumpymap.layers.products import PRODUCT_NAMES, VIEW_NAMES
from bumpymap.views import write_map_views
from bumpytiles import Grid, TileWindow

TOP = {
    *("report.html", "map.qgs", "cost.tif", "cost.qml", "cost.geojson", "cost.fgb", "tiles.parquet", "tiles.qml"),
    *("run.json", "item.json", "rasters"),
}
"""What a newcomer finds when he opens the folder of a map: at most a dozen entries."""
RUN = {"calibration": {"id": "c0ffee", "vehicle": "warthog"}, "model": "m1", "seconds": {"read": 1.5}}


def write(cost_map, folder, *, local=False, manifest=RUN, progress=None):
    return write_products(
        CostTable.of(cost_map), folder, views=write_map_views, local=local, manifest=manifest, progress=progress
    )


def hashes(folder):
    return {name: hashlib.sha256(content).hexdigest() for name, content in files_in(folder).items()}


def test_all_files_of_a_run(tmp_path, cost_map):
    paths, summary = write(cost_map, tmp_path)
    assert summary.tiles == len(cost_map.class_id)
    assert paths == [tmp_path / name for name in (*PRODUCT_NAMES, *VIEW_NAMES)]
    assert {path.name for path in tmp_path.iterdir()} == TOP
    record = json.loads((tmp_path / "run.json").read_text())
    found = hashes(tmp_path)
    assert set(found) == {*PRODUCT_NAMES, *VIEW_NAMES, *SIDES}
    assert {entry["path"]: entry["sha256"] for entry in record["files"]} == {
        name: found[name] for name in PRODUCT_NAMES if name != "run.json"
    }
    assert record["seconds"]["read"] == 1.5
    assert record["seconds"]["write"] > 0
    assert record["counts"]["tiles"] == len(cost_map.class_id)
    newest = max(found, key=lambda name: (tmp_path / name).stat().st_mtime_ns)
    assert newest == "run.json"


def said_by_layers(folder):
    """Metadata of every layer, as texts."""
    found = {}
    for path in folder.rglob("*.tif"):
        with rasterio.open(path) as file:
            found[path.relative_to(folder).as_posix()] = file.tags()
    schema = pq.read_schema(folder / "tiles.parquet").metadata
    found["tiles.parquet"] = {key.decode(): value.decode() for key, value in schema.items()}
    found["cost.fgb"] = pyogrio.read_info(folder / "cost.fgb")["layer_metadata"]
    collection = json.loads((folder / "cost.geojson").read_text(encoding="utf-8"))
    limits = collection.pop("class_limits_rad_per_m", [])
    found["cost.geojson"] = collection | ({"class_limits_rad_per_m": " ".join(map(str, limits))} if limits else {})
    return found


FULL_RUN = RUN | {
    "survey": {"name": "Grünfläche <1> & 2", "checksum": "blake3-1MiB:ab", "dates": ["2024-05-01", "2024-05-03"]},
    "calibration": {"id": "c0ffee", "vehicle": "warthog", "class_limits": (0.111, 0.25, 0.4)},
    "settings": {"rating": "ride", "compat": "none"},
}


def test_every_layer_says_which_survey_vehicle_and_version_made_it(tmp_path, cost_map):
    write(cost_map, tmp_path, manifest=FULL_RUN)
    found = said_by_layers(tmp_path)
    assert set(found) == set(PRODUCT_NAMES) - {"item.json", "run.json"}  # these say more, see their own tests
    wanted = {
        "survey": "Grünfläche <1> & 2",
        "survey_checksum": "blake3-1MiB:ab",
        "survey_header_dates": "2024-05-01/2024-05-03",
        "vehicle": "warthog",
        "calibration": "c0ffee",
        "texture_model": "m1",
        "rating": "ride",
        "class_limits_rad_per_m": "0.111 0.25 0.4",
        "bumpymap_version": software_versions()["bumpymap"],
        "vertical_crs": "none given; heights as in the survey, in metres",
    }
    for name, entries in found.items():
        assert {key: entries.get(key) for key in wanted} == wanted, name


@pytest.mark.slow
def test_same_map_same_bytes_whatever_the_order_of_its_tiles(tmp_path, make_field):
    cost_map = make_field(110, 90, grid=Grid(3.0, 5))
    shuffled = part_of(cost_map, np.random.default_rng(0).permutation(len(cost_map.class_id)))
    seen = []
    for name, twin in {"a": cost_map, "other_name": shuffled}.items():
        (tmp_path / name).mkdir()
        write(twin, tmp_path / name)
        seen.append({key: value for key, value in hashes(tmp_path / name).items() if key != "run.json"})
    assert seen[0] == seen[1]


def test_scratch_of_a_killed_run_goes_and_nothing_else(tmp_path):
    code = (
        "import os, pathlib, sys\n"
        "from bumpymap.core.files import write_together\n"
        "with write_together(pathlib.Path(sys.argv[1]), 'run.json') as staged:\n"
        "    (staged / 'heightmap.tif').write_text('half'); (staged / 'old').mkdir(); os._exit(1)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    assert len(list(tmp_path.iterdir())) == 1
    mine = [tmp_path / ".heightmap.notes", tmp_path / ".class.txt", tmp_path / "heightmap.bak"]
    for path in mine:
        path.write_text("mine")
    check_folder(tmp_path, overwrite=False)
    assert sorted(tmp_path.iterdir()) == sorted(mine)


@pytest.mark.parametrize("name", ["run.json", "rasters/class.tif", "map.qgs", "rasters/class.qml"])
def test_products_of_a_run_are_not_overwritten_unasked(tmp_path, name):
    (tmp_path / "notes.txt").write_text("not ours")
    check_folder(tmp_path, overwrite=False)
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("ours")
    with pytest.raises(OutputError, match=f"already holds {name}.*`overwrite=True`"):
        check_folder(tmp_path, overwrite=False)
    check_folder(tmp_path, overwrite=True)
    assert (tmp_path / name).read_text() == "ours"


def test_a_map_of_the_first_version_is_replaced_whole(tmp_path, cost_map):
    """It had all files at the top; a file that is not its own stays."""
    paths, _ = write(cost_map, tmp_path)
    whole = files_in(tmp_path)
    for path in paths[0].parent.iterdir():
        path.rename(tmp_path / path.name)
    record = json.loads((tmp_path / "run.json").read_text()) | {"version": 1}
    (tmp_path / "run.json").write_text(json.dumps(record))
    (tmp_path / "rasters" / "mine.tif").write_text("mine")
    check_folder(tmp_path, overwrite=True)
    write(cost_map, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == TOP
    assert set(files_in(tmp_path)) == {*whole, "rasters/mine.tif"}


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_of_rasters_that_is_a_link_is_refused(tmp_path, cost_map, overwrite):
    out, mine = tmp_path / "out", tmp_path / "mine"
    for folder in (out, mine):
        folder.mkdir()
    (mine / "class.tif").write_text("mine")
    (out / "rasters").symlink_to(mine)
    with pytest.raises(OutputError, match="rasters is a link or no folder, and was not touched"):
        check_folder(out, overwrite=overwrite)
    with pytest.raises(OutputError, match="Nothing was replaced"):  # one that was put there later
        write(cost_map, out)
    assert files_in(mine) == {"class.tif": b"mine"}
    assert [path.name for path in out.iterdir()] == ["rasters"]


def test_no_crs_is_refused_before_any_file(tmp_path, make_field):
    cost_map = make_field(4, 4, georeference=Georeference(None))
    with pytest.raises(BadInputError, match="`local=True`"):
        write(cost_map, tmp_path, manifest={})
    assert list(tmp_path.iterdir()) == []
    assert len(write(cost_map, tmp_path, local=True)[0]) == len(PRODUCT_NAMES) + len(VIEW_NAMES)


def test_an_extent_is_limited_in_tiles_and_in_pixels():
    side = int(MAX_TILES**0.5)
    check_extent(Grid(3.0, 15), TileWindow(0, 0, side, side))
    with pytest.raises(BadInputError, match="tiles"):
        check_extent(Grid(3.0, 1), TileWindow(0, 0, side + 1, side))
    with pytest.raises(BadInputError, match="pixels"):
        check_extent(Grid(3.0, 60), TileWindow(0, 0, side // 3, side // 3))


def test_ending_while_writing_leaves_nothing(tmp_path, cost_map):
    class Impatient(SilentProgress):
        def advance(self, steps):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(cost_map, tmp_path, progress=Impatient())
    assert list(tmp_path.iterdir()) == []
