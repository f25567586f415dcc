"""Folders of maps: all files or none, no link followed; of those of others nothing is read but their own files."""

import hashlib
import json
import os
import resource
import subprocess
import sys
import threading
from contextlib import contextmanager, nullcontext
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pyogrio
import pytest
import rasterio
import shapely
from cost_maps import make_field, regions_of, table_of, write_flatgeobuf, write_geojson
from made_drives import MadeDrive, log_of, write_table
from pyproj import CRS
from route_maps import RUN, bare_map, copy_folder, list_anew, write_folder
from small_surveys import SIDES, files_in

from bumpymap.api import open_layers
from bumpymap.change import diff_surveys
from bumpymap.check import check_drives
from bumpymap.core import BadInputError, ExportSettings, OutputError, atomic, write_together
from bumpymap.layers import describe_file, describe_input, open_map, read_areas, read_points, software_versions
from bumpymap.layers.folder import write_products, write_raster
from bumpymap.layers.placement import MAX_TILES, check_extent
from bumpymap.layers.products import PRODUCT_NAMES, VIEW_NAMES, MapFile, check_folder
from bumpymap.layers.tile_table import write_tiles
from bumpymap.views import export_map, write_map_views, write_report
from bumpytiles import Grid, TileWindow

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
