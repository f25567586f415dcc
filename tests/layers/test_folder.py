"""The folder of a map: all files or none, nothing replaced that was not meant, no link followed; and its manifest."""

import hashlib
import json
import os
import resource
import subprocess
import sys
from contextlib import contextmanager, nullcontext
from pathlib import Path

import pyarrow.parquet as pq
import pyogrio
import pytest
import rasterio
from cost_maps import table_of
from region_files import regions_of, write_flatgeobuf, write_geojson
from route_maps import RUN
from small_surveys import SIDES, files_in

from bumpymap.core.errors import BadInputError, OutputError
from bumpymap.core.files import atomic, write_together
from bumpymap.layers import check_extent, check_folder, write_products
from bumpymap.layers.geotiff import write_raster
from bumpymap.layers.manifest import describe_file, describe_input, software_versions
from bumpymap.layers.placement import MAX_TILES
from bumpymap.layers.products import PRODUCT_NAMES, VIEW_NAMES, MapFile
from bumpymap.layers.tile_table import write_tiles
from bumpymap.views import write_map_views
from bumpytiles import Grid, TileWindow

TOP = {
    *("report.html", "map.qgs", "cost.tif", "cost.qml", "cost.geojson", "cost.fgb", "tiles.parquet", "tiles.qml"),
    *("run.json", "item.json", "rasters"),
}
"""What a newcomer finds when he opens the folder of a map: at most a dozen entries."""
RUN = RUN | {"seconds": {"read": 1.5}}


def texts_in(folder):
    return {name: content.decode() for name, content in files_in(folder).items()}


def fill(folder, files):
    for name, text in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)


def write(cost_map, folder, *, local=False, manifest=RUN):
    return write_products(table_of(cost_map), folder, views=write_map_views, local=local, manifest=manifest)


def test_all_files_of_a_run(tmp_path, cost_map):
    paths, summary = write(cost_map, tmp_path)
    assert summary.tiles == len(cost_map.class_id)
    assert paths == [tmp_path / name for name in (*PRODUCT_NAMES, *VIEW_NAMES)]
    assert {path.name for path in tmp_path.iterdir()} == TOP
    record = json.loads((tmp_path / "run.json").read_text())
    found = {name: hashlib.sha256(content).hexdigest() for name, content in files_in(tmp_path).items()}
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
    found["cost.geojson"] = json.loads((folder / "cost.geojson").read_text(encoding="utf-8"))
    limits = found["cost.geojson"]["class_limits_rad_per_m"]
    found["cost.geojson"]["class_limits_rad_per_m"] = " ".join(map(str, limits))
    return found


def test_every_layer_says_which_survey_vehicle_and_version_made_it(tmp_path, cost_map):
    about = {"name": "Grünfläche <1> & 2", "checksum": "blake3:ab", "dates": ["2024-05-01", "2024-05-03"]}
    calibration = RUN["calibration"] | {"class_limits": (0.111, 0.25, 0.4)}
    write(cost_map, tmp_path, manifest=RUN | {"survey": about, "calibration": calibration})
    found = said_by_layers(tmp_path)
    assert set(found) == set(PRODUCT_NAMES) - {"item.json", "run.json"}  # these say more, see their own tests
    wanted = {
        "survey": "Grünfläche <1> & 2",
        "survey_checksum": "blake3:ab",
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


def test_scratch_of_a_killed_run_goes_and_nothing_else(tmp_path):
    code = (
        "import os, pathlib, sys\n"
        "from bumpymap.core.files import write_together\n"
        "with write_together(pathlib.Path(sys.argv[1]), 'run.json') as staged:\n"
        "    (staged / 'heightmap.tif').write_text('half'); (staged / 'old').mkdir(); os._exit(1)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    assert len(list(tmp_path.iterdir())) == 1
    mine = dict.fromkeys((".heightmap.notes", ".class.txt", "heightmap.bak"), "mine")
    fill(tmp_path, mine)
    check_folder(tmp_path, overwrite=False)
    assert texts_in(tmp_path) == mine


def test_a_folder_of_rasters_that_is_a_link_is_refused(tmp_path, cost_map):
    out, mine = tmp_path / "out", tmp_path / "mine"
    fill(tmp_path, {"mine/class.tif": "mine"})
    out.mkdir()
    (out / "rasters").symlink_to(mine)
    for overwrite in (False, True):
        with pytest.raises(OutputError, match="rasters is a link or no folder, and was not touched"):
            check_folder(out, overwrite=overwrite)
    with pytest.raises(OutputError, match="Nothing was replaced"):  # one that was put there later
        write(cost_map, out)
    assert texts_in(mine) == {"class.tif": "mine"}
    assert [path.name for path in out.iterdir()] == ["rasters"]


def test_an_extent_is_limited_in_tiles_and_in_pixels():
    side = int(MAX_TILES**0.5)
    check_extent(Grid(3.0, 15), TileWindow(0, 0, side, side))
    with pytest.raises(BadInputError, match="tiles"):
        check_extent(Grid(3.0, 1), TileWindow(0, 0, side + 1, side))
    with pytest.raises(BadInputError, match="pixels"):
        check_extent(Grid(3.0, 60), TileWindow(0, 0, side // 3, side // 3))


@contextmanager
def largest_file(size):
    """No file may grow beyond ``size`` bytes: what a full disk looks like to a program."""
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, old[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)


def test_failure_keeps_the_old_file_and_leaves_no_scratch(tmp_path):
    fill(tmp_path, {"a.tif": "old"})
    with pytest.raises(TypeError), atomic(tmp_path / "a.tif") as temporary:
        fill(temporary.parent, {temporary.name: "half", f"{temporary.stem}.scratch.tif": "scratch", "no text": None})
    assert texts_in(tmp_path) == {"a.tif": "old"}


def test_side_file_moves_along_and_a_stale_one_goes(tmp_path):
    fill(tmp_path, {"a.tif.aux.xml": "statistics of other pixels"})
    for wanted in ({"a.tif": "1"}, {"a.tif": "2", "a.tif.aux.xml": "categories"}):
        with atomic(tmp_path / "a.tif") as temporary:
            fill(temporary.parent, {name.replace("a.tif", temporary.name): text for name, text in wanted.items()})
        assert texts_in(tmp_path) == wanted


ALONE = {
    **{
        Path(file).name: lambda cost_map, path, file=file: write_raster(file, table_of(cost_map), path)
        for file in (MapFile.ROUGHNESS, MapFile.CLASS, MapFile.HEIGHTMAP, MapFile.RELIEF)
    },
    "tiles.parquet": lambda cost_map, path: write_tiles(table_of(cost_map), path),
    "cost.geojson": lambda cost_map, path: write_geojson(regions_of(cost_map), path, local=False),
    "cost.fgb": lambda cost_map, path: write_flatgeobuf(regions_of(cost_map), path),
}


@pytest.mark.slow
@pytest.mark.parametrize("small", [True, False])
@pytest.mark.parametrize("product", ALONE)
def test_full_disk_is_an_error_and_leaves_nothing(tmp_path, make_field, monkeypatch, product, small):
    if not small:  # what large layers do
        monkeypatch.setattr("bumpymap.layers.vector.IN_MEMORY", 0)
        monkeypatch.setattr("bumpymap.layers._cog.SMALL", 0)
    cost_map, path = make_field(20, 15), tmp_path / product
    ALONE[product](cost_map, path)
    whole = path.stat().st_size
    for file in tmp_path.iterdir():
        file.unlink()
    with pytest.raises(OutputError, match="cannot write"), largest_file(whole - 1):
        ALONE[product](cost_map, path)
    assert texts_in(tmp_path) == {}


MINE = {"notes.txt": "mine", "in/notes.txt": "mine"}
OLD = MINE | {"a.tif": "old a", "a.tif.aux.xml": "old side", "b.tif": "old b", "run.json": "old run"}
OLD |= {"in/a.tif": "old a", "in/gone.tif": "old", "in/gone.tif.aux.xml": "old side"}
NEW = {"a.tif": "new a", "b.tif": "new b", "b.tif.aux.xml": "new side", "c.tif": "new c", "run.json": "new run"}
NEW |= {"in/a.tif": "new a", "in/c.tif": "new c"}
EARLIER = ("a.tif", "in/a.tif", "in/c.tif", "in/gone.tif")


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_files_appear_together_or_the_old_ones_come_back(tmp_path, monkeypatch, error):
    """Whichever move fails; run.json goes first and comes last."""
    fill(tmp_path, OLD)
    replace, moves = os.replace, len(OLD) - len(MINE) + len(NEW)
    for number in range(moves + 1):
        moved = []

        def move(source, target, number=number, moved=moved, **folders):
            moved.append((source, target))
            if len(moved) == number + 1:
                raise error
            replace(source, target, **folders)

        monkeypatch.setattr("os.replace", move)
        caught = pytest.raises((OutputError, KeyboardInterrupt), match=r"^$|Nothing was replaced")
        with caught if number < moves else nullcontext(), write_together(tmp_path, "run.json", EARLIER) as staged:
            fill(staged, NEW)
            assert {name: (tmp_path / name).read_text() for name in OLD} == OLD
        assert texts_in(tmp_path) == (OLD if number < moves else MINE | NEW)
    assert moved[0][0] == moved[-1][1] == "run.json"


def test_inputs_get_a_checksum_if_they_are_unchanged(tmp_path, monkeypatch):
    survey, made = tmp_path / "survey.laz", hashlib.file_digest
    survey.write_bytes(b"points" * 1000)
    digest = hashlib.sha256(b"points" * 1000).hexdigest()
    record = {"path": survey, "points": 12, "bytes": 6000, "mtime_ns": str(survey.stat().st_mtime_ns)}
    assert describe_input(record) == record | {"sha256": digest}
    with pytest.raises(BadInputError, match="changed while"):
        describe_input(record | {"mtime_ns": "1"})

    def grow(file, method):
        with survey.open("ab") as more:
            more.write(b"more")
        return made(file, method)

    monkeypatch.setattr(hashlib, "file_digest", grow)
    with pytest.raises(BadInputError, match="changed while"):
        describe_file(survey)
