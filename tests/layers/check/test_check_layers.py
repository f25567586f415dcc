"""The stretches and tiles of a check for GIS."""

import json
from dataclasses import replace

import numpy as np
import pytest
from check_records import STRETCH_M, made_up_check
from pyproj import CRS, Transformer
from route_records import UTM, MadeUpMap

from bumpymap.core import CLASS_NAMES, Georeference
from bumpymap.layers.check_vectors import CheckPlaces, write_stretches

TO_UTM = Transformer.from_crs("OGC:CRS84", "EPSG:32614", always_xy=True)


def places_of(result, georeference=UTM):
    ground = replace(MadeUpMap.around(), georeference=georeference)
    return CheckPlaces.of(result.stretches, ground)


def written(write, result, places, path):
    write(result, places, path)
    return json.loads(path.read_text())


def test_stretches_lie_where_they_were_driven(tmp_path):
    result = made_up_check(unknown=[2])
    found = written(write_stretches, result, places_of(result), tmp_path / "check.geojson")
    assert len(found["features"]) == 40
    lonlat = np.array([feature["geometry"]["coordinates"] for feature in found["features"]])
    x, y = TO_UTM.transform(*lonlat.T)
    assert np.hypot(x - result.stretches.easting, y - result.stretches.northing).max() < 0.02
    west, south, east, north = found["bbox"]
    assert (west, south, east, north) == (*lonlat.min(axis=0), *lonlat.max(axis=0))
    assert [feature["id"] for feature in found["features"]] == list(range(1, 41))
    about = found["features"][0]["properties"]
    stretches = result.stretches
    assert about["measured"] == pytest.approx(stretches.measured[0], abs=1e-6)
    assert about["ratio"] == pytest.approx(stretches.c_r[0] / stretches.measured[0], abs=1e-4)
    assert about["drive"] == "drive 1"
    assert about["way_m"] == STRETCH_M
    assert about["class_name"] == CLASS_NAMES[about["class"]]
    unknown = found["features"][2]["properties"]
    assert {name: unknown[name] for name in ("c_r", "ratio", "class", "class_name", "explained", "off")} == {
        **dict.fromkeys(("c_r", "ratio", "class", "class_name", "explained")),
        "off": "not compared",
    }
    assert unknown["measured_class"] is not None


def test_stretches_without_a_position_are_left_out(tmp_path):
    result = made_up_check()
    easting = result.stretches.easting.copy()
    easting[5:8] = np.nan
    result = replace(result, stretches=replace(result.stretches, easting=easting))
    found = written(write_stretches, result, places_of(result), tmp_path / "check.geojson")
    assert [feature["id"] for feature in found["features"]] == [*range(1, 6), *range(9, 41)]


@pytest.mark.parametrize("unit", [1.0, 0.3048])
def test_without_a_crs_the_own_coordinates_are_kept_and_declared(tmp_path, unit):
    result = made_up_check()
    places = places_of(result, Georeference(None, unit))
    found = written(write_stretches, result, places, tmp_path / "check.geojson")
    own = np.array([feature["geometry"]["coordinates"] for feature in found["features"]])
    assert own[:, 0] == pytest.approx(result.stretches.easting / unit, abs=1e-3)
    assert "not longitude and latitude" in found["local_coordinates"]


def test_a_crs_in_feet(tmp_path):
    """Positions of stretches are metres on the grid, files hold the units of the CRS."""
    feet = CRS.from_epsg(2277)  # Texas Central, US survey feet
    unit = feet.axis_info[0].unit_conversion_factor
    result = made_up_check()
    easting, northing = result.stretches.easting + 600_000.0, result.stretches.northing + 1_000_000.0
    moved = replace(result.stretches, easting=easting, northing=northing)
    result = replace(result, stretches=moved)
    found = written(write_stretches, result, places_of(result, Georeference(feet, unit)), tmp_path / "check.geojson")
    lonlat = np.array([feature["geometry"]["coordinates"] for feature in found["features"]])
    back = Transformer.from_crs("OGC:CRS84", feet, always_xy=True).transform(*lonlat.T)
    assert np.asarray(back[0]) * unit == pytest.approx(moved.easting, abs=0.02)
    assert np.asarray(back[1]) * unit == pytest.approx(moved.northing, abs=0.02)
