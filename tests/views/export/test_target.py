"""An export appears whole or not at all, replaces only its own kind, and says where on Earth it lies."""

import json
import math

import numpy as np
import pytest
from pyproj import CRS, Geod

from bumpymap.core import Georeference, OutputError
from bumpymap.layers import open_map
from bumpymap.views import ExportSettings, export_map

GRAPH, NAV2 = ExportSettings(to="graph"), ExportSettings(to="nav2")


def snapshot(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_an_earlier_export_is_replaced_only_if_asked(easy_map, route_map, tmp_path):
    out = tmp_path / "out"
    export_map(easy_map, out, NAV2)
    before = snapshot(out)
    assert sorted(before) == sorted(path.name for path in out.iterdir())
    with pytest.raises(OutputError, match="`overwrite=True`"):
        export_map(route_map, out, NAV2)
    with pytest.raises(OutputError, match="in another format"):
        export_map(route_map, out, GRAPH, overwrite=True)
    assert snapshot(out) == before
    done = export_map(route_map, out, NAV2, overwrite=True)
    after = snapshot(out)
    assert set(after) == set(before)
    assert after["map.pgm"] != before["map.pgm"]
    assert json.loads(after["datum.json"]) == done.record
    assert [path.name for path in done.files][-1] == "datum.json"


@pytest.mark.parametrize("to", ["nav2", "gridmap", "graph", "cost"])
def test_the_same_map_has_the_same_bytes(easy_map, tmp_path, to):
    for name in ("a", "b"):
        export_map(easy_map, tmp_path / name, ExportSettings(to=to))
    assert snapshot(tmp_path / "a") == snapshot(tmp_path / "b")


def test_links_are_replaced_and_never_followed(easy_map, tmp_path):
    out, precious = tmp_path / "out", tmp_path / "precious"
    out.mkdir()
    precious.write_text("mine")
    (out / "map.pgm").symlink_to(precious)
    with pytest.raises(OutputError, match=r"map\.pgm"):
        export_map(easy_map, out, NAV2)
    export_map(easy_map, out, NAV2, overwrite=True)
    assert precious.read_text() == "mine"
    assert not (out / "map.pgm").is_symlink()


def test_other_files_stay_and_layers_are_no_place_for_it(easy_map, easy_folder, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    export_map(easy_map, out, GRAPH)
    assert (out / "notes.txt").read_text() == "mine"
    before = snapshot(easy_folder)
    with pytest.raises(OutputError, match="holds the layers of a run"):
        export_map(easy_map, easy_folder, GRAPH, overwrite=True)
    assert snapshot(easy_folder) == before
    with pytest.raises(OutputError, match="it is a file"):
        export_map(easy_map, out / "notes.txt", GRAPH)
    (tmp_path / "odd" / "graph.geojson").mkdir(parents=True)
    with pytest.raises(OutputError, match="is not a file"):
        export_map(easy_map, tmp_path / "odd", GRAPH, overwrite=True)


def test_the_datum_says_where_the_frame_lies(easy_map, tmp_path):
    """A way to the north and one to the east of the frame, laid on the ellipsoid from the datum."""
    record = export_map(easy_map, tmp_path / "out", NAV2).record
    datum, crs = record["datum"], easy_map.georeference.crs
    assert datum["crs"]["code"] == "EPSG:32614"
    assert (datum["x"] % 3.0, datum["y"] % 3.0) == (0.0, 0.0)
    assert (record["area"]["west"] % 3.0, record["area"]["north"] % 3.0) == (0.0, 0.0)
    geod = Geod(ellps="WGS84")
    for east, north in ((0.0, 50.0), (50.0, 0.0)):
        end = easy_map.to_lonlat(datum["x"] + east, datum["y"] + north)
        azimuth, _, length = geod.inv(datum["longitude"], datum["latitude"], *end)
        bearing = math.degrees(math.atan2(east, north)) + datum["grid_convergence_deg"]
        assert azimuth == pytest.approx(bearing, abs=1e-3)
        assert length == pytest.approx(50.0 / datum["grid_scale"], rel=1e-5)
    assert crs.to_epsg() == 32614
    assert abs(datum["grid_convergence_deg"]) > 0.1


def test_a_map_in_feet_is_exported_in_metres(make_field, write_map, tmp_path):
    foot = 1200.0 / 3937.0
    crs = CRS.from_epsg(2274)  # Tennessee, US survey feet
    west, south = int(1_740_000 * foot / 3), int(660_000 * foot / 3)
    ground = make_field(8, 6, west=west, south=south, georeference=Georeference(crs, foot, foot), easy=True)
    feet_map = open_map(write_map(ground, tmp_path / "feet"))
    record = export_map(feet_map, tmp_path / "out", NAV2).record
    assert record["resolution_m"] == 3.0
    area, window = record["area"], feet_map.window
    assert area["east"] - area["west"] == pytest.approx(window.cols * 3.0)
    corner = (record["datum"]["x"] * foot + area["west"], record["datum"]["y"] * foot + area["south"])
    np.testing.assert_allclose(corner, (window.col * 3.0, window.row * 3.0), atol=1e-6)
