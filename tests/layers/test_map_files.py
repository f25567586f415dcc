"""Folders of layers that somebody else made: nothing is fetched or read but their own files, each as it was written."""

import json
import os
import threading
from contextlib import nullcontext
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
import rasterio
import shapely
from cost_maps import make_field
from made_drives import MadeDrive, log_of, write_table
from pyproj import CRS
from route_maps import bare_map, copy_folder, list_anew, write_folder

from bumpymap.api import open_layers
from bumpymap.change import diff_surveys
from bumpymap.check import check_drives
from bumpymap.core import BadInputError
from bumpymap.layers import open_map, read_areas, read_points
from bumpymap.views import ExportSettings, export_map, write_report
from bumpytiles import Grid

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
        threading.Thread(target=server.serve_forever, daemon=True).start()
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
    log = log_of(MadeDrive(seconds=60.0, noise=0.01))[0]
    check_drives(folder, write_table(out / "drive.csv", log, (330_005.0, 2_040_012.0)))


def dataset(folder, _):
    layers = open_layers(folder)
    repr(layers)
    layers.heights().load()
    layers.dataset().load()


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
        ("tiles.parquet", report),
    ],
)
def test_a_layer_that_is_not_the_one_of_the_manifest_is_refused(one, tmp_path, name, read):
    folder = copy_folder(one, tmp_path / "map")
    damage(folder / name)
    with pytest.raises(BadInputError, match="is damaged: its checksum"):
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
