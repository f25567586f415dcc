"""Runs: the folder of files, the calls of Python, and yards within walls that are surveyed, mapped and left."""

import hashlib
import json
import logging
import math
import re

import numpy as np
import pytest
import xarray
from pyproj import Transformer
from ring_maps import SIDE_M, TOOLS, Yard, read_graph
from route_maps import write_folder
from route_records import CORNERS, UTM, MadeUpMap, make_route
from route_sites import ROWS, SOUTH, WEST, place, site
from scipy.sparse.csgraph import dijkstra

import bumpymap
from bumpymap.core import BadInputError, Georeference, OutputError, UsageError
from bumpymap.layers import ReachField, open_map
from bumpymap.route import output as folder_module
from bumpymap.route.output import REACH_KINDS, ROUTE_FILES, ROUTE_KINDS, check_out, write_reach_files, write_routes
from bumpytiles import Grid, TileWindow

FOUR = ["profile.csv", "route.geojson", "route.gpx", "route.json", "route.png"]
START = np.array([330_004.5, 2_040_004.5])
SETTINGS = {"settings": {"risk_m": 25.0, "robust": False}}
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


@pytest.fixture(scope="module")
def source():
    return MadeUpMap.around()


@pytest.fixture(autouse=True)
def no_picture(monkeypatch):
    """A picture takes a quarter of a second; its own tests look at it."""
    monkeypatch.setattr(folder_module, "write_route_picture", lambda *given: given[-1].write_bytes(b"PNG"))


@pytest.fixture
def reach():
    cost = np.arange(12, dtype=np.float32).reshape(3, 4)
    return ReachField(UTM, Grid(), TileWindow(110_000, 680_000, 4, 3), cost)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def write(out, source, **options):
    return write_routes([make_route()], source, out, manifest=SETTINGS, **options)


def test_a_folder_gets_every_file_and_the_manifest(source, tmp_path):
    out = tmp_path / "new" / "routes"
    check_out(out, ROUTE_KINDS, overwrite=False)
    assert not out.exists()
    files = write_routes([make_route(), make_route("two", stops=CORNERS)], source, out, manifest=SETTINGS)
    assert names(out) == FOUR
    assert [path.name for path in files] == [name for name in ROUTE_FILES.names if name in FOUR]
    record = json.loads((out / "route.json").read_text())
    assert record["format"] == "bumpymap-route"
    assert record["settings"] == SETTINGS["settings"]
    assert record["calibration"] == {"id": "c0ffee"}
    assert "bumpymap" in record["versions"]
    assert [route["name"] for route in record["routes"]] == ["route", "two"]
    assert [stop["name"] for stop in record["routes"][1]["stops"]] == ["start", "via 1", "goal"]
    assert record["routes"][0]["stops"][0]["x"] == CORNERS[0, 0]
    assert record["notes"] == []
    for entry in record["files"]:
        content = (out / entry["path"]).read_bytes()
        assert (entry["bytes"], entry["sha256"]) == (len(content), hashlib.sha256(content).hexdigest())


@pytest.mark.parametrize("suffix", [".geojson", ".gpx", ".csv", ".png", ".GPX"])
def test_one_file_by_its_suffix(suffix, source, tmp_path):
    out = tmp_path / f"way{suffix}"
    assert write(out, source) == [out]
    assert names(tmp_path) == [out.name]
    with pytest.raises(OutputError, match="exists"):
        write(out, source)
    assert write(out, source, overwrite=True) == [out]


def test_files_of_an_earlier_run_are_replaced_only_if_allowed_and_links_are_not_followed(source, reach, tmp_path):
    out, mine = tmp_path / "out", tmp_path / "mine"
    write_reach_files(reach, source, START, out, levels=[5.0], manifest={})
    for path in (mine, out / "notes.txt"):
        path.write_text("mine")
    for link in (out / "profile.csv", tmp_path / "way.csv"):
        link.symlink_to(mine)
    before = {path: path.read_bytes() for path in out.iterdir()}
    with pytest.raises(OutputError, match="already holds"):
        check_out(out, ROUTE_KINDS, overwrite=False)
    for target in (tmp_path / "way.csv", out):
        with pytest.raises(OutputError, match=r"already holds|exists"):
            write(target, source)
        assert {path: path.read_bytes() for path in out.iterdir()} == before
        write(target, source, overwrite=True)
    assert not (out / "profile.csv").is_symlink()
    assert not (tmp_path / "way.csv").is_symlink()
    assert names(out) == sorted([*FOUR, "notes.txt"])  # reach.tif would not belong to the new route.json
    assert mine.read_text() == "mine"


def test_without_a_crs_gpx_is_left_out_and_said(source, tmp_path, caplog):
    route = make_route(georeference=Georeference(None))
    with caplog.at_level(logging.WARNING):
        files = write_routes([route], source, tmp_path, manifest={})
    assert names(tmp_path) == [name for name in FOUR if name != "route.gpx"]
    assert "route.gpx" not in {path.name for path in files}
    assert "no CRS" in caplog.text
    record = json.loads((tmp_path / "route.json").read_text())
    assert "no CRS" in record["notes"][0]
    assert "lon" not in record["routes"][0]["stops"][0]
    with pytest.raises(BadInputError, match="no CRS"):
        write_routes([route], source, tmp_path / "way.gpx", manifest={})


@pytest.mark.parametrize(
    ("kinds", "name", "error", "words"),
    [
        (ROUTE_KINDS, "way.kml", UsageError, r"\.geojson, \.gpx, \.csv, \.png"),
        (REACH_KINDS, "way.gpx", UsageError, r"\.tif, \.geojson"),
        (ROUTE_KINDS, "file", OutputError, "it is a file"),
        (ROUTE_KINDS, "missing/way.csv", OutputError, "there is no folder"),
    ],
)
def test_places_that_cannot_hold_the_files_are_refused(source, tmp_path, kinds, name, error, words):
    (tmp_path / "file").touch()
    with pytest.raises(error, match=words):
        check_out(tmp_path / name, kinds, overwrite=True)
    if kinds is ROUTE_KINDS:
        with pytest.raises(error, match=words):
            write(tmp_path / name, source, overwrite=True)
    (tmp_path / "route.png").mkdir()
    with pytest.raises(OutputError, match="is not a file"):
        write(tmp_path, source, overwrite=True)
    assert names(tmp_path) == ["file", "route.png"]


def test_the_reach_has_files_of_its_own(source, reach, tmp_path):
    check_out(tmp_path / "all", REACH_KINDS, overwrite=False)
    files = write_reach_files(reach, source, START, tmp_path / "all", levels=[5.0, 9.0], manifest=SETTINGS)
    assert [path.name for path in files] == ["reach.tif", "reach.png", "isochrones.geojson", "route.json"]
    assert names(tmp_path / "all") == sorted(path.name for path in files)
    few = write_reach_files(reach, source, START, tmp_path / "few", manifest=SETTINGS)
    assert [path.name for path in few] == ["reach.tif", "reach.png", "route.json"]
    for name in ("cost.tif", "within.geojson", "minutes.png"):
        out = tmp_path / name
        assert write_reach_files(reach, source, START, out, levels=[5.0], manifest={}) == [out]
    with pytest.raises(UsageError, match="levels"):
        write_reach_files(reach, source, START, tmp_path / "other.geojson", manifest={})


@pytest.fixture(scope="module")
def layers(tmp_path_factory):
    return bumpymap.open(write_folder(tmp_path_factory.mktemp("api") / "layers", site()))


def pair(row, col):
    return tuple(float(value) for value in place(row, col).split(","))


def test_a_route_is_a_line_with_figures(layers):
    way = layers.route(pair(20.5, 8.5), place(20.5, 22.5))
    table = way.to_geodataframe()
    assert table.crs.to_epsg() == 32614
    assert table.geometry[0].length == pytest.approx(way.figures.length_m, rel=1e-9)
    assert table["cost_m"][0] == pytest.approx(way.figures.cost_m, abs=1e-3)
    assert way.profile.distance[-1] == pytest.approx(way.figures.length_m, rel=1e-9)
    assert f"{way.figures.length_m:,.1f} m" in repr(way)


def test_settings_and_alternatives(layers, tmp_path):
    ends = (pair(20.5, 8.5), pair(20.5, 22.5))
    found = bumpymap.find_routes(
        layers.folder, *ends, via=[pair(5.5, 12.5)], alternatives=3, risk=0, out=tmp_path / "way.geojson"
    )
    assert [way.name for way in found] == ["route", *(f"alternative {at}" for at in range(1, len(found)))]
    assert found[0].risk_m == 0.0
    assert (tmp_path / "way.geojson").is_file()


def test_a_reach_is_a_dataset(layers):
    reach = layers.reach(pair(20.5, 8.5))
    assert isinstance(reach, xarray.Dataset)
    assert reach.rio.crs.to_epsg() == 32614
    x, y = pair(20.5, 22.5)
    cost = float(reach["cost"].sel(x=x, y=y))
    way = layers.route(pair(20.5, 8.5), (x, y))
    assert way.figures.cost_m <= cost <= 1.03 * way.figures.cost_m
    assert np.isnan(reach["cost"].sel(x=(WEST + 15.5) * 3, y=(SOUTH + ROWS - 20.5) * 3))
    assert set(bumpymap.map_reach(layers, pair(20.5, 8.5), minutes=0.5).data_vars) == {"cost", "minutes"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gap", "thickness", "density", "classified"),
    [(0.0, 0.1, 50, True), (0.0, 0.2, 50, False), (1.0, 0.3, 50, False), (2.3, 0.2, 50, True), (2.3, 0.1, 20, False)],
)
def test_a_wall_is_a_wall_for_all_that_read_the_map(tmp_path, gap, thickness, density, classified):
    yard = Yard(gap, thickness, density, classified, seed=int(100 * gap + 10 * thickness + density))
    layers = yard.map(tmp_path)
    fits = gap >= 2.0
    way = yard.way_out(layers)
    assert (way is not None) == fits
    if fits:
        line, obstacle_m = way
        assert abs(np.interp(0.5 * SIDE_M, *line.T)) < 0.5 * gap - 0.4
        assert obstacle_m == 0.0
    assert yard.is_reached(layers) == fits
    assert yard.crossed_by_tools(layers) == dict.fromkeys(TOOLS, fits)


@pytest.mark.slow
def test_a_solver_that_follows_the_graph_goes_where_a_route_goes(tmp_path):
    yard = Yard(2.3, 0.2, 50, classified=True, seed=7)
    layers = yard.map(tmp_path)
    places, costs = read_graph(open_map(layers), tmp_path / "graph")
    start, goal = (int(np.hypot(*(places - end).T).argmin()) for end in yard.ends)
    spent, before = dijkstra(costs, indices=start, return_predecessors=True)
    nodes = [goal]
    while nodes[-1] != start:
        nodes.append(before[nodes[-1]])
    (route,) = bumpymap.find_routes(layers, tuple(places[start]), tuple(places[goal]))
    assert route.figures.cost_m <= spent[goal] < 1.08 * route.figures.cost_m
    for line in (places[nodes[::-1]], route.line):
        x, y = yard.place.in_scene(*line.T)
        assert abs(np.interp(0.5 * SIDE_M, x, y)) < 0.5 * 2.3 - 0.4


@pytest.mark.slow
def test_without_a_way_the_message_names_the_gap_that_is_too_narrow(tmp_path):
    yard = Yard(2.0, 0.2, 50, classified=True, seed=4)
    layers = yard.map(tmp_path, vehicle="car")
    with pytest.raises(bumpymap.BadInputError) as raised:
        bumpymap.find_routes(layers, *yard.ends, snap=6.0)
    said = re.search(r"widest opening .* (\S+),(\S+) \(longitude, latitude\), about (\S+) m wide", str(raised.value))
    longitude, latitude, width = map(float, said.groups())
    place = Transformer.from_crs(4326, 32632, always_xy=True).transform(longitude, latitude)
    assert math.dist(place, yard.place.of_scene(0.5 * SIDE_M + 0.1, 0.0)) < 0.6
    assert 1.5 < width < 2.0
