"""The folder of a run: all files or none, nothing replaced that was not meant, no link followed."""

import hashlib
import json
import logging

import numpy as np
import pytest
from route_records import CORNERS, UTM, MadeUpMap, make_route

from bumpymap.core import BadInputError, Georeference, OutputError, UsageError
from bumpymap.layers import ReachField
from bumpymap.route import output as folder_module
from bumpymap.route.output import (
    REACH_KINDS,
    ROUTE_FILES,
    ROUTE_KINDS,
    ROUTE_MANIFEST_NAME,
    check_out,
    write_reach_files,
    write_routes,
)
from bumpytiles import Grid, TileWindow

FOUR = ["profile.csv", "route.geojson", "route.gpx", "route.json", "route.png"]
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
    record = json.loads((out / ROUTE_MANIFEST_NAME).read_text())
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


@pytest.mark.parametrize("name", ["way.kml", "way.json", "way.tif", "way.PDF"])
def test_a_file_of_another_kind_is_refused(name, source, tmp_path):
    words = r"\.geojson, \.gpx, \.csv, \.png"
    with pytest.raises(UsageError, match=words):
        check_out(tmp_path / name, ROUTE_KINDS, overwrite=False)
    with pytest.raises(UsageError, match=words):
        write(tmp_path / name, source)
    assert not list(tmp_path.iterdir())


def test_files_of_an_earlier_run_are_replaced_only_if_allowed(source, reach, tmp_path):
    write_reach_files(reach, source, np.array([330_004.5, 2_040_004.5]), tmp_path, levels=[5.0], manifest={})
    (tmp_path / "notes.txt").write_text("mine")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(OutputError, match="already holds"):
        check_out(tmp_path, ROUTE_KINDS, overwrite=False)
    with pytest.raises(OutputError, match="already holds"):
        write(tmp_path, source)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    write(tmp_path, source, overwrite=True)
    assert names(tmp_path) == sorted([*FOUR, "notes.txt"])  # reach.tif would not belong to the new route.json


@pytest.mark.parametrize("name", ["routes", "way.csv"])
def test_links_are_replaced_never_followed(name, source, tmp_path):
    precious = tmp_path / "precious"
    precious.write_text("keep")
    out = tmp_path / name
    link = out
    if name == "routes":
        out.mkdir()
        link = out / "profile.csv"
    link.symlink_to(precious)
    with pytest.raises(OutputError):
        write(out, source)
    write(out, source, overwrite=True)
    assert precious.read_text() == "keep"
    assert not link.is_symlink()
    assert link.stat().st_size > 100


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


def test_places_that_cannot_hold_the_files_are_refused(source, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="it is a file"):
        check_out(tmp_path / "file", ROUTE_KINDS, overwrite=True)
    with pytest.raises(OutputError, match="there is no folder"):
        check_out(tmp_path / "missing" / "way.csv", ROUTE_KINDS, overwrite=False)
    (tmp_path / "route.png").mkdir()
    with pytest.raises(OutputError, match="is not a file"):
        write(tmp_path, source, overwrite=True)


def test_the_reach_has_files_of_its_own(source, reach, tmp_path):
    check_out(tmp_path / "all", REACH_KINDS, overwrite=False)
    start = np.array([330_004.5, 2_040_004.5])
    files = write_reach_files(reach, source, start, tmp_path / "all", levels=[5.0, 9.0], manifest=SETTINGS)
    assert [path.name for path in files] == ["reach.tif", "reach.png", "isochrones.geojson", "route.json"]
    assert names(tmp_path / "all") == sorted(path.name for path in files)
    few = write_reach_files(reach, source, start, tmp_path / "few", manifest=SETTINGS)
    assert [path.name for path in few] == ["reach.tif", "reach.png", "route.json"]
    for name in ("cost.tif", "within.geojson", "minutes.png"):
        out = tmp_path / name
        assert write_reach_files(reach, source, start, out, levels=[5.0], manifest={}) == [out]
    with pytest.raises(UsageError, match="levels"):
        write_reach_files(reach, source, start, tmp_path / "other.geojson", manifest={})
    with pytest.raises(UsageError, match=r"\.tif, \.geojson"):
        check_out(tmp_path / "way.gpx", REACH_KINDS, overwrite=False)
