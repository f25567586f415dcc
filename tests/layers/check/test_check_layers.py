"""The stretches and tiles of a check for GIS."""

import json
from dataclasses import replace

import numpy as np
import pytest
from check_records import STRETCH_M, made_up_check
from pyproj import CRS, Transformer
from route_records import UTM, MadeUpMap

from bumpymap.core import CLASS_NAMES, Georeference
from bumpymap.layers.check_vectors import place_stretches, write_stretches

FEET = CRS.from_epsg(2277)  # Texas Central, US survey feet
UNIT = FEET.axis_info[0].unit_conversion_factor


def written(result, path, georeference=UTM):
    """The file, and the positions in it."""
    ground = replace(MadeUpMap.around(), georeference=georeference)
    write_stretches(result, place_stretches(result.stretches, ground), path)
    found = json.loads(path.read_text())
    return found, np.array([feature["geometry"]["coordinates"] for feature in found["features"]])


@pytest.mark.parametrize(
    ("georeference", "shift"), [(UTM, (0.0, 0.0)), (Georeference(FEET, UNIT), (600_000.0, 1_000_000.0))]
)
def test_stretches_lie_where_they_were_driven(tmp_path, georeference, shift):
    """Positions of stretches are metres on the grid, files hold the units of the CRS."""
    made = made_up_check().stretches
    driven = replace(made, easting=made.easting + shift[0], northing=made.northing + shift[1])
    found, lonlat = written(replace(made_up_check(), stretches=driven), tmp_path / "check.geojson", georeference)
    back = Transformer.from_crs("OGC:CRS84", georeference.crs, always_xy=True).transform(*lonlat.T)
    x, y = np.asarray(back) * georeference.metres_per_unit
    assert np.hypot(x - driven.easting, y - driven.northing).max() < 0.02
    assert found["bbox"] == [*lonlat.min(axis=0), *lonlat.max(axis=0)]


def test_stretches_say_what_was_measured_and_what_the_map_says(tmp_path):
    result = made_up_check(unknown=[2])
    found, _ = written(result, tmp_path / "check.geojson")
    assert [feature["id"] for feature in found["features"]] == list(range(1, 41))
    about, stretches = found["features"][0]["properties"], result.stretches
    assert about["measured"] == pytest.approx(stretches.measured[0], abs=1e-6)
    assert about["ratio"] == pytest.approx(stretches.c_r[0] / stretches.measured[0], abs=1e-4)
    assert (about["drive"], about["way_m"]) == ("drive 1", STRETCH_M)
    assert about["class_name"] == CLASS_NAMES[about["class"]]
    unknown = found["features"][2]["properties"]
    assert [unknown[name] for name in ("c_r", "ratio", "class", "class_name", "explained")] == [None] * 5
    assert unknown["off"] == "not compared"
    assert unknown["measured_class"] is not None


def test_stretches_without_a_position_are_left_out(tmp_path):
    result = made_up_check()
    result.stretches.easting[5:8] = np.nan
    found, _ = written(result, tmp_path / "check.geojson")
    assert [feature["id"] for feature in found["features"]] == [*range(1, 6), *range(9, 41)]


def test_without_a_crs_the_own_coordinates_are_kept_and_declared(tmp_path):
    result = made_up_check()
    found, own = written(result, tmp_path / "check.geojson", Georeference(None, 0.3048))
    assert own[:, 0] == pytest.approx(result.stretches.easting / 0.3048, abs=1e-3)
    assert "not longitude and latitude" in found["local_coordinates"]
