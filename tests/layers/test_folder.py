"""Folders of maps, all files or none, no link followed; read by windows and GeoPandas, and only their own files."""

import hashlib
import json
import os
import resource
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from shutil import rmtree

import geopandas
import numpy as np
import pyarrow as pa
import pyarrow.dataset as pads
import pyarrow.parquet as pq
import pyogrio
import pytest
import rasterio
import shapely
from cost_maps import lone_columns, make_field, make_map, regions_of, table_of, write_flatgeobuf, write_geojson
from geopandas.testing import assert_geodataframe_equal
from hypothesis import given, settings, strategies as st
from made_drives import MadeDrive, log_of, write_table
from pyproj import CRS
from route_maps import RUN, bare_map, copy_folder, list_anew, write_folder
from small_surveys import SIDES as SIDE_FILES, files_in

import bumpymap
from bumpymap.api import open_layers
from bumpymap.change import diff_surveys
from bumpymap.check import check_drives
from bumpymap.core import NO_CLASS, NO_TILE, BadInputError, ExportSettings, OutputError, atomic, write_together
from bumpymap.core.types import BANDS, BARRED_TEXT, REASON_TEXT, SIDES, TEXTURES, Barred, Reason
from bumpymap.layers import ZoneCounts, describe_file, open_map, read_areas, read_points, software_versions, tile_table
from bumpymap.layers.folder import write_products, write_raster
from bumpymap.layers.manifest import describe_input, summarise
from bumpymap.layers.placement import MAX_TILES, check_extent
from bumpymap.layers.products import EVERY_VIEW_NAME, PRODUCT_NAMES, MapFile, check_folder
from bumpymap.layers.tile_table import write_tiles
from bumpymap.views import export_map, write_map_views, write_report, zones_line
from bumpytiles import Grid, TileTable, TileWindow

TOP = {
    *("report.html", "map.qgs", "cost.tif", "cost.qml", "cost.geojson", "cost.fgb", "tiles.parquet", "tiles.qml"),
    *("run.json", "item.json", "rasters"),
}
"""What a newcomer finds when he opens the folder of a map: at most a dozen entries."""
TIMED_RUN = RUN | {"seconds": {"read": 1.5}}


def texts_in(folder):
    return {name: content.decode() for name, content in files_in(folder).items()}


def fill(folder, files):
    for name, text in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)


def write_map(cost_map, folder, *, local=False, manifest=TIMED_RUN):
    return write_products(table_of(cost_map), folder, views=write_map_views, local=local, manifest=manifest)


def test_all_files_of_a_run(tmp_path, cost_map):
    paths, summary = write_map(cost_map, tmp_path)
    assert summary.tiles == len(cost_map.class_id)
    assert paths == [tmp_path / name for name in (*PRODUCT_NAMES, *EVERY_VIEW_NAME)]
    assert {path.name for path in tmp_path.iterdir()} == TOP
    record = json.loads((tmp_path / "run.json").read_text())
    found = {name: hashlib.sha256(content).hexdigest() for name, content in files_in(tmp_path).items()}
    assert set(found) == {*PRODUCT_NAMES, *EVERY_VIEW_NAME, *SIDE_FILES}
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
    write_map(cost_map, tmp_path, manifest=RUN | {"survey": about, "calibration": calibration})
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
        write_map(cost_map, out)
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
def test_full_disk_is_an_error_and_leaves_nothing(tmp_path, monkeypatch, product, small):
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


# ---- folders that somebody else made: nothing is fetched or read but their own files, each as it was written ----


SMALL = Grid(3.0, 5)

VRT = """<VRTDataset rasterXSize="60" rasterYSize="50"><GeoTransform>480000,0.6,0,2136030,0,-0.6</GeoTransform>
<VRTRasterBand dataType="Float32" band="1"><SimpleSource><SourceFilename relativeToVRT="0">{}</SourceFilename>
<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"""
OGR_VRT = """<OGRVRTDataSource><OGRVRTLayer name="a"><SrcDataSource>/vsicurl/{}</SrcDataSource></OGRVRTLayer>
</OGRVRTDataSource>"""


@pytest.fixture(name="server")
def serve():
    """A URL of this machine, and the paths that were asked for."""
    asked = []

    class Handler(BaseHTTPRequestHandler):
        def parse_request(self):
            asked.append(self.raw_requestline)
            return False

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}", asked
        server.shutdown()


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    made = make_field(12, 10, grid=SMALL, easy=True)
    return write_folder(tmp_path_factory.mktemp("one") / "map", made)


def report(folder, out):
    write_report(folder, out / "page.html")


def export(folder, out):
    export_map(open_map(folder), out / "grids", ExportSettings("nav2"))


def bag(folder, out):
    export_map(open_map(folder), out / "bag", ExportSettings("gridmap"))


def diff(folder, out):
    diff_surveys(folder, folder, out / "diff")


def relief(folder, _):
    site = open_map(folder)
    site.heights(site.window)
    site.relief(site.window, (5, 6))


def check(folder, out):
    log = log_of(MadeDrive(seconds=36.0, noise=0.01))[0]
    check_drives(folder, write_table(out / "drive.csv", log, (330_005.0, 2_040_012.0)))


def dataset(folder, _):
    layers = open_layers(folder)
    repr(layers)
    layers.heights().load()
    layers.dataset().load()


def tables(folder, _):
    layers = open_layers(folder)
    layers.tiles()


def virtual(path, aim):
    path.write_text(VRT.format(aim))


def tagged(path, aim):
    with rasterio.open(path, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as file:
        file.update_tags(ns="OVERVIEWS", OVERVIEW_FILE=aim)


def beside(path, aim):
    text = f'<PAMDataset><Metadata domain="OVERVIEWS"><MDI key="OVERVIEW_FILE">{aim}</MDI></Metadata></PAMDataset>'
    path.with_name(f"{path.name}.aux.xml").write_text(text)
    path.with_name(f"{path.name}.ovr").write_text(VRT.format(aim))


READERS = (report, export, diff, relief, dataset, check)
PLANTS = [
    *((plant, read) for plant in (virtual, beside) for read in READERS),
    *((tagged, read) for read in READERS if read is not check),
]


@pytest.mark.parametrize(("plant", "read"), PLANTS)
def test_a_folder_of_layers_leads_nowhere_else(one, server, tmp_path, plant, read):
    url, asked = server
    folder = copy_folder(one, tmp_path / "map")
    for name in ("rasters/heightmap.tif", "rasters/class.tif", "rasters/obstacle.tif"):
        plant(folder / name, f"/vsicurl/{url}/{tmp_path.name}/{name}")
    list_anew(folder)
    with nullcontext() if plant is beside else pytest.raises(BadInputError, match=str(folder)):
        read(folder, tmp_path)
    assert not asked


@pytest.mark.parametrize("in_memory", [1 << 30, 0])
def test_a_raster_is_written_without_the_files_of_the_current_folder(server, tmp_path, monkeypatch, in_memory):
    """GDAL takes these names for the overviews and the mask of a raster without a name."""
    monkeypatch.setattr("bumpymap.layers._cog.SMALL", in_memory)
    for suffix in (".ovr", ".OVR", ".msk", ".MSK"):
        (tmp_path / suffix).write_text(VRT.format(f"/vsicurl/{server[0]}/{tmp_path.name}/{suffix[1:]}"))
    monkeypatch.chdir(tmp_path)
    write_folder(tmp_path / "map", make_field(12, 10, grid=SMALL, easy=True))
    assert not server[1]


@pytest.mark.parametrize("read", [relief, report, lambda folder, _: read_areas(folder / "a.json", bare_map())])
def test_a_crs_that_leads_elsewhere_is_refused(one, tmp_path, read):
    named = f"+proj=utm +zone=14 +ellps=clrk66 +nadgrids=@{tmp_path}/pipe +type=crs"
    crs = json.loads((one / "run.json").read_text())["crs"] | {"wkt": CRS(named).to_wkt()}
    folder = copy_folder(one, tmp_path / "map", crs=crs)
    os.mkfifo(tmp_path / "pipe")
    areas = {"type": "Feature", "geometry": shapely.geometry.mapping(shapely.box(0, 0, 9, 9)), "properties": {}}
    areas |= {"crs": {"type": "name", "properties": {"name": named}}}
    (folder / "a.json").write_text(json.dumps(areas))
    with nullcontext() if read is report else pytest.raises(BadInputError, match="names a file by its path"):
        read(folder, tmp_path)


@pytest.mark.parametrize(("name", "read"), [("rasters/class.tif", dataset), ("rasters/roughness.tif", export)])
def test_a_layer_that_does_not_fit_is_refused(one, tmp_path, name, read):
    """It lies elsewhere than the others, or the names of its bands are no text."""
    folder = copy_folder(one, tmp_path / "map")
    if read is dataset:
        with rasterio.open(folder / name, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as file:
            file.transform *= file.transform.translation(1, 0)
    else:
        (folder / name).write_bytes((folder / name).read_bytes().replace(b">c_r<", b">\xbf_r<"))
    list_anew(folder)
    with pytest.raises(BadInputError, match=str(folder)):
        read(folder, tmp_path)


@pytest.mark.parametrize(("band", "value"), [("c_r", -1000.0), ("c_r_high", -1.0), ("p_fail", 1.5)])
def test_values_that_cannot_be_are_refused(one, tmp_path, band, value):
    """A way would be led over them: they would make it cheaper."""
    folder = copy_folder(one, tmp_path / "map")
    with rasterio.open(folder / "rasters/roughness.tif", "r+", IGNORE_COG_LAYOUT_BREAK="YES") as file:
        number = file.descriptions.index(band) + 1
        file.write(np.full(file.shape, value, np.float32), number)
    list_anew(folder)
    site = open_map(folder)
    with pytest.raises(BadInputError, match=rf"roughness\.tif.*damaged: {band}"):
        site.read(site.window)


def damage(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("name", "read"),
    [
        *(("rasters/class.tif", read) for read in (report, dataset, diff, bag)),
        *(("rasters/heightmap.tif", read) for read in (report, dataset, diff, check)),
        *(("tiles.parquet", read) for read in (report, tables)),
    ],
)
def test_a_layer_that_is_not_the_one_of_the_manifest_or_not_there_is_refused(one, tmp_path, name, read):
    folder = copy_folder(one, tmp_path / "map")
    damage(folder / name)
    with pytest.raises(BadInputError, match="is damaged: its checksum"):
        read(folder, tmp_path)
    (folder / name).unlink()
    with pytest.raises(BadInputError, match=f"{name} is missing"):
        read(folder, tmp_path)


def test_a_large_raster_is_held_against_its_checksum_when_it_is_read(one, tmp_path, monkeypatch):
    monkeypatch.setattr("bumpymap.layers.map_reader.CHECKED_BYTES", 100)
    folder = copy_folder(one, tmp_path / "map")
    damage(folder / "rasters/heightmap.tif")
    site = open_map(folder)
    assert site.read(site.window).window == site.window
    for read in (lambda: site.heights(site.window), lambda: site.relief(site.window, (5, 6))):
        with pytest.raises(BadInputError, match=r"heightmap\.tif is damaged: its checksum"):
            read()


@pytest.mark.parametrize("suffix", [".geojson", ".gpx"])
@pytest.mark.parametrize("read", [read_points, lambda path: read_areas(path, bare_map())])
def test_a_vector_file_leads_nowhere_else(server, tmp_path, suffix, read):
    url, asked = server
    path = tmp_path / f"a{suffix}"
    link = {"type": "link", "properties": {"href": url}}
    feature = {"type": "Feature", "properties": {}, "geometry": shapely.geometry.mapping(shapely.Point(1, 2))}
    for text in (
        OGR_VRT.format(f"{url}/{tmp_path.name}"),
        json.dumps({"type": "FeatureCollection", "crs": link, "features": [feature]}),
        f'<!DOCTYPE gpx [<!ENTITY a SYSTEM "{url}">]><gpx><wpt lat="1" lon="2"><name>&a;</name></wpt></gpx>',
        f"<!-- <gpx --> {OGR_VRT.format(url)}",
    ):
        path.write_text(text)
        with pytest.raises(BadInputError):
            read(path)
    assert not asked


READ = ("c_r", "c_r_low", "c_r_high", "p_fail", "obstacle")
SMALLER = Grid(3.0, 4)


@pytest.fixture(scope="module")
def made():
    return make_field(50, 37, grid=SMALLER, seed=8)


@pytest.fixture(scope="module")
def folder(made, tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("route") / "layers", made)


def same(first, second):
    return all(np.array_equal(getattr(first, name), getattr(second, name), equal_nan=True) for name in READ) and (
        np.array_equal(first.barred, second.barred)
    )


def test_every_tile_lies_where_it_was_measured(folder, made):
    found = open_map(folder)
    field = found.read(found.window)
    row = found.window.row + found.window.rows - 1 - made.patches.row
    col = made.patches.col - found.window.col
    held = np.zeros(field.barred.shape, bool)
    held[row, col] = True
    assert np.array_equal(field.barred == NO_TILE, ~held)
    columns = lone_columns(made)
    assert np.array_equal(field.barred[row, col], columns["barred"])
    for name in READ:
        assert np.array_equal(getattr(field, name)[row, col], columns[name], equal_nan=True), name
        assert np.isnan(getattr(field, name)[~held]).all()
    assert found.rule == made.rule


def test_a_window_is_a_piece_of_the_whole_also_beyond_the_map(folder):
    found = open_map(folder)
    whole = found.window
    around = TileWindow(whole.col - 7, whole.row - 5, whole.cols + 20, whole.rows + 9)
    field, heights, objects = found.read(around), found.heights(around), found.objects(around)
    rng = np.random.default_rng(1)
    for _ in range(10):
        top, left = int(rng.integers(0, 40)), int(rng.integers(0, 60))
        rows, cols = int(rng.integers(1, around.rows - top + 1)), int(rng.integers(1, around.cols - left + 1))
        window = TileWindow(around.col + left, around.row + around.rows - top - rows, cols, rows)
        part = found.read(window)
        for name in ("barred", *READ):
            expected = getattr(field, name)[top : top + rows, left : left + cols]
            assert np.array_equal(getattr(part, name), expected, equal_nan=True)
        pixels = np.s_[4 * top : 4 * (top + rows), 4 * left : 4 * (left + cols)]
        assert np.array_equal(found.heights(window), heights[pixels], equal_nan=True)
        assert np.array_equal(found.objects(window), objects[pixels])


def test_passage_in_fewer_pixels(folder):
    """At full size the same; in fewer pixels, what is free there is free on one of those beneath."""
    found = open_map(folder)
    whole = found.window
    around = TileWindow(whole.col - 2, whole.row - 1, whole.cols + 4, whole.rows + 3)
    fine = found.passage(around)
    assert np.array_equal(found.passage(around, fine.shape), fine)
    rows, cols = fine.shape[0] // 2, fine.shape[1] // 2
    coarse = found.passage(around, (rows, cols))
    assert not (coarse & ~fine[: 2 * rows, : 2 * cols].reshape(rows, 2, cols, 2).any(axis=(1, 3))).any()


def test_coarse_relief_holds_means(folder):
    found = open_map(folder)
    whole = found.window
    blocks = found.heights(whole).reshape(whole.rows, 4, whole.cols, 4)
    known = np.isfinite(blocks).sum(axis=(1, 3))
    means = np.nansum(blocks, axis=(1, 3)) / np.where(known, known, np.nan)
    coarse = found.relief(whole, (whole.rows, whole.cols))
    full = known == 16  # an overview of an overview weighs pixels beside holes differently
    np.testing.assert_allclose(coarse[full], means[full], atol=1e-3)
    np.testing.assert_array_equal(np.isnan(coarse), known == 0)
    assert np.abs(coarse - means)[known > 0].max() < 0.5


def test_threads_read_a_map_that_is_kept_open(folder):
    found = open_map(folder)
    whole = found.window
    corners = np.random.default_rng(3).integers(0, (whole.cols - 5, whole.rows - 5), (60, 2)).tolist()
    windows = [TileWindow(whole.col + col, whole.row + row, 5, 5) for col, row in corners]
    wanted = [(found.read(window), found.passage(window)) for window in windows]

    def read(window):
        with found.kept_open():
            return found.read(window), found.passage(window)

    with ThreadPoolExecutor(4) as pool:
        for (field, passage), (own, open_pixels) in zip(wanted, pool.map(read, windows), strict=True):
            assert same(field, own)
            assert np.array_equal(passage, open_pixels)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("route") / "small", make_field(20, 16, grid=SMALLER))


@pytest.mark.parametrize(
    ("change", "entries", "words"),
    [
        (lambda folder: (folder / "run.json").unlink(), {}, "no complete run"),
        (rmtree, {}, "there is no folder"),
        *((lambda _: None, {key: {"a": 1}}, r"run\.json is damaged") for key in ("grid", "files", "crs", "inputs")),
        (lambda _: None, {"metres_per_unit": {"horizontal": 1e308, "vertical": 1}}, r"run\.json is damaged"),
        (lambda _: None, {"grid": {"tile_size_m": 3.0, "pixels": float("inf")}}, r"run\.json is damaged"),
        (lambda _: None, {"format": ["x"]}, "no complete run"),
        (
            lambda _: None,
            {"format": "bumpymap-sheets", "sheets": []},
            r"layers holds a map of another version.*Map the",
        ),
    ],
)
def test_what_is_no_complete_run_of_this_version_is_refused(small, tmp_path, change, entries, words):
    folder = copy_folder(small, tmp_path / "layers", **entries)
    change(folder)
    with pytest.raises(BadInputError, match=words):
        open_map(folder)


def test_rasters_of_another_place_are_refused(small, tmp_path):
    """A raster that was copied from another run; its size and checksum are entered, so only its place is wrong."""
    folder = copy_folder(small, tmp_path / "layers")
    other = write_folder(tmp_path / "other", make_field(20, 17, grid=SMALLER))
    (folder / "cost.tif").write_bytes((other / "cost.tif").read_bytes())
    list_anew(folder)
    with pytest.raises(BadInputError, match=r"cost\.tif spans other tiles"):
        open_map(folder)
    list_anew(folder, grid=json.loads((folder / "run.json").read_text())["grid"] | {"tile_size_m": 2.5})
    with pytest.raises(BadInputError, match="does not lie on the grid"):
        open_map(folder)


@pytest.fixture(name="written", scope="module")
def written_fixture(tmp_path_factory, cost_map):
    path = tmp_path_factory.mktemp("table") / "tiles.parquet"
    write_tiles(table_of(cost_map), path)
    return path


def test_columns_types_and_compression(written):
    schema = pq.read_schema(written)
    assert schema.names == [
        *("col", "row", "geometry", "bbox", *(band.name for band in BANDS), *(f"step_{side}" for side in SIDES)),
        *("barred", "count", "z_min", "z_max", "relief", "texture", *(f"p_{texture}" for texture in TEXTURES)),
        *("class", "reason", "reason_text", "heights"),
    ]
    assert schema.field("class").type == schema.field("reason").type == pa.int8()
    assert schema.field("heights").type == pa.list_(pa.float32(), 225)
    assert schema.field("c_r").metadata[b"unit"] == b"rad/m"
    group = pq.ParquetFile(written).metadata.row_group(0)
    assert {group.column(i).compression for i in range(group.num_columns)} == {"ZSTD"}


def test_geopandas_reads_every_value_back(written, cost_map):
    frame = geopandas.read_parquet(written)
    assert frame.crs.equals(CRS.from_epsg(32614))
    patches = cost_map.patches
    order = np.lexsort([patches.col, -patches.row])  # north first, then west
    columns = lone_columns(cost_map)
    for band in BANDS:
        expected = np.where(columns["zone"] > 0, columns["zone"], np.nan) if band.name == "zone" else columns[band.name]
        np.testing.assert_array_equal(frame[band.name].to_numpy(float), expected[order])
    for name in ("col", "row", "count", "z_min", "z_max", "relief", "reason"):
        np.testing.assert_array_equal(frame[name], getattr(patches, name)[order])
    class_id = np.where(cost_map.class_id == NO_CLASS, np.nan, cost_map.class_id)
    np.testing.assert_array_equal(frame["class"], class_id[order])
    for number, texture in enumerate(TEXTURES):
        np.testing.assert_array_equal(frame[f"p_{texture}"], cost_map.probability[order, number])
    np.testing.assert_array_equal(np.stack(frame["heights"]).reshape(-1, 15, 15), patches.heights[order])
    barred = [BARRED_TEXT[code] if code else None for code in lone_columns(cost_map)["barred"][order]]
    assert frame["barred"].astype(object).where(frame["barred"].notna(), None).tolist() == barred
    assert frame["passable"].tolist() == [text is None for text in barred]
    assert frame["reason_text"].tolist() == [REASON_TEXT[Reason(code)] for code in patches.reason[order]]


def test_geometry_is_that_of_geoparquet_with_boxes_that_are_the_bounds_of_the_tiles(written):
    table = pq.read_table(written)
    geo = json.loads(table.schema.metadata[b"geo"])
    assert (geo["version"], geo["primary_column"]) == ("1.1.0", "geometry")
    column, sides = geo["columns"]["geometry"], ("xmin", "ymin", "xmax", "ymax")
    bounds = shapely.bounds(shapely.from_wkb(table["geometry"].to_numpy()))
    assert {name: column[name] for name in ("encoding", "geometry_types", "orientation", "bbox", "covering")} == {
        "encoding": "WKB",
        "geometry_types": ["Polygon"],
        "orientation": "counterclockwise",
        "bbox": [*bounds[:, :2].min(axis=0), *bounds[:, 2:].max(axis=0)],
        "covering": {"bbox": {side: ["bbox", side] for side in sides}},
    }
    assert CRS.from_json_dict(column["crs"]) == CRS.from_epsg(32614)
    boxes = table["bbox"].combine_chunks()
    assert boxes.type == pa.struct([pa.field(side, pa.float64(), nullable=False) for side in sides])
    np.testing.assert_array_equal(np.stack(boxes.flatten()), bounds.T)


def test_a_reader_with_a_box_skips_row_groups(tmp_path):
    path = tmp_path / "t.parquet"
    write_tiles(table_of(make_field(400, 200, grid=Grid(3.0, 1))), path)
    whole = geopandas.read_parquet(path)
    west, south, _, _ = whole.total_bounds
    box = (west + 100.5, south + 50.5, west + 130.5, south + 80.5)
    found = geopandas.read_parquet(path, bbox=box)
    inside = whole[whole.intersects(shapely.box(*box))]
    assert len(inside) > 50
    assert_geodataframe_equal(found.reset_index(drop=True), inside.reset_index(drop=True))
    low, high = (pads.field("bbox", "xmin") <= box[2]), (pads.field("bbox", "xmax") >= box[0])
    meets = low & high & (pads.field("bbox", "ymin") <= box[3]) & (pads.field("bbox", "ymax") >= box[1])
    (fragment,) = pads.dataset(path).get_fragments()
    groups = [group.id for part in fragment.split_by_row_group(meets) for group in part.row_groups]
    assert 0 < len(groups) < pq.ParquetFile(path).metadata.num_row_groups == 5


@pytest.fixture
def site(tmp_path):
    return write_folder(tmp_path / "site", make_field(12, 9))


def repeated(site, times):
    """Return the tiles many times over: a small file, since equal rows take next to nothing."""
    table = pq.read_table(site / "tiles.parquet").drop_columns(["heights", "geometry", "bbox"])
    return table.take(pa.array(np.repeat(np.arange(len(table)), times)))


def test_more_rows_than_the_run_counts_are_refused_before_they_are_read(site):
    pq.write_table(repeated(site, 10_000), site / "tiles.parquet")
    list_anew(site)
    before = pa.default_memory_pool()
    pool = pa.proxy_memory_pool(before)
    pa.set_memory_pool(pool)
    try:
        for read in (lambda: write_report(site), bumpymap.open(site).tiles):
            with pytest.raises(
                BadInputError, match=r"tiles\.parquet holds [\d,]+ rows, and run\.json counts \d+ tiles"
            ):
                read()
    finally:
        pa.set_memory_pool(before)
    assert pool.max_memory() < 1 << 20


def test_a_row_group_larger_than_a_run_writes_is_refused(site):
    table = repeated(site, 1000)
    pq.write_table(table, site / "tiles.parquet", row_group_size=len(table))
    counts = json.loads((site / "run.json").read_text(encoding="utf-8"))["counts"]
    list_anew(site, counts=counts | {"tiles": len(table)})
    with pytest.raises(BadInputError, match=r"a group of [\d,]+ rows; at most 65,536 are read at once"):
        write_report(site)


def test_rows_that_do_not_fit_into_memory_are_refused(site, monkeypatch):
    monkeypatch.setattr(tile_table, "free_memory", lambda: 1000)
    with pytest.raises(BadInputError, match=r"tiles\.parquet takes .* of memory, and .* are free"):
        write_report(site)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.sampled_from([0, 1, 2, 3, NO_CLASS]), min_size=1, max_size=30), st.integers(0, 9), st.integers(1, 40)
)
def test_counts_and_medians_are_those_of_all_tiles(class_id, seed, cols):
    tiles = np.arange(len(class_id))
    cost_map = make_map(tiles % cols, tiles // cols, class_id, [3 if k == NO_CLASS else 0 for k in class_id], seed=seed)
    summary = summarise(table_of(cost_map))
    assert summary.tiles == len(class_id)
    assert summary.points == cost_map.patches.count.sum()
    assert summary.median_count == np.median(cost_map.patches.count)
    assert summary.by_class == tuple(class_id.count(k) for k in range(4))
    free = (cost_map.class_id != NO_CLASS) & (cost_map.p_fail < 0.5)
    assert summary.passable == (free & (cost_map.patches.slope <= cost_map.rule.slope_limit_deg)).sum()
    assert summary.by_reason == (0, 0, 0, class_id.count(NO_CLASS), 0, 0)
    for number, group in enumerate([0, 1, 2, 3, NO_CLASS]):
        chosen = cost_map.class_id == group
        for found, values, near in (
            (summary.median_c_r, cost_map.c_r, 1e-4),
            (summary.median_slope, cost_map.patches.slope, 1e-3),
        ):
            known = values[chosen][np.isfinite(values[chosen])].astype(float)
            expected = np.median(known) if len(known) else np.nan
            assert found[number] == pytest.approx(expected, abs=near, nan_ok=True)


def test_the_median_of_the_last_class_is_of_the_tiles_that_their_c_r_puts_there():
    cost_map = make_map(np.arange(5), np.zeros(5, int), [3, 3, 3, 3, 0], [0] * 5)
    cost_map.c_r[:] = [0.1, 0.2, 0.5, 0.7, 0.05]
    cost_map.p_fail[:] = [0.9, 0.02, 0.9, 0.0, 0.0]  # the second is too steep
    summary = summarise(table_of(cost_map), (0.1, 0.2, 0.4))
    assert summary.failing == 2
    assert summary.median_c_r[3] == pytest.approx(0.6, abs=1e-4)
    assert summary.by_class == (1, 0, 0, 4)


def test_what_hangs_together_is_counted_and_small_pieces_but_the_largest_are_islands():
    zone = np.repeat([1, 2, 3, 0], [100, 60, 5, 1]).astype(np.int32)  # 900, 540 and 45 m2
    cost_map = make_map(np.arange(len(zone)), np.zeros(len(zone), int), [0] * len(zone), [0] * len(zone), easy=True)
    columns = lone_columns(cost_map) | {"zone": zone}
    columns["barred"][[0, 164]] = Barred.SPLIT
    summary = summarise(replace(table_of(cost_map), tiles=TileTable.of(cost_map.patches.grid, columns)))
    assert summary.zones == ZoneCounts(3, 99, 891.0, 99 / 164, 1, 4)
    line = "60% of what can be crossed hangs together in one piece of 891 m²"
    assert zones_line(summary.zones, "%") == f"{line}; 4 tiles lie on islands under 500 m²"
    alone = ZoneCounts.of(np.array([0, 7]), 7, 9.0)
    assert alone.island_tiles == 0
    assert zones_line(alone, "%") == "100% of what can be crossed hangs together in one piece of 63 m²"
    assert zones_line(ZoneCounts.of(np.zeros(0, int), 0, 9.0)) == ""
