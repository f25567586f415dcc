"""The stretches of a check for GIS, and how far a map is off: closed forms."""

import json
from dataclasses import replace

import numpy as np
import pytest
from check_records import STRETCH_M, made_up_check, stretches_at
from hypothesis import given, strategies as st
from pyproj import CRS, Transformer
from route_records import UTM, MadeUpMap

from bumpymap.check.pipeline import agreement_of
from bumpymap.core import CLASS_NAMES, Georeference
from bumpymap.layers.check_vectors import NOT_COMPARED, OFF_KINDS, MapOffset, place_stretches, write_stretches

FEET = CRS.from_epsg(2277)  # Texas Central, US survey feet
UNIT = FEET.axis_info[0].unit_conversion_factor


def written(result, path, georeference=UTM):
    """The file, and the positions in it."""
    ground = replace(MadeUpMap.around(), georeference=georeference)
    write_stretches(result, place_stretches(result.stretches, ground), path)
    found = json.loads(path.read_text())
    return found, np.array([feature["geometry"]["coordinates"] for feature in found["features"]])


@pytest.mark.parametrize(
    ("georeference", "shift"),
    [(UTM, (0.0, 0.0)), (Georeference(FEET, UNIT), (600_000.0, 1_000_000.0)), (Georeference(None, 0.3048), (0.0, 0.0))],
)
def test_stretches_lie_where_they_were_driven(tmp_path, georeference, shift):
    """Positions of stretches are metres on the grid, files hold the units of the CRS."""
    made = made_up_check().stretches
    driven = replace(made, easting=made.easting + shift[0], northing=made.northing + shift[1])
    found, places = written(replace(made_up_check(), stretches=driven), tmp_path / "check.geojson", georeference)
    assert ("local_coordinates" in found) == (georeference.crs is None)
    assert found["bbox"] == [*places.min(axis=0), *places.max(axis=0)]
    if georeference.crs is not None:
        back = Transformer.from_crs("OGC:CRS84", georeference.crs, always_xy=True)
        places = np.column_stack(back.transform(*places.T))
    x, y = places.T * georeference.metres_per_unit
    assert np.hypot(x - driven.easting, y - driven.northing).max() < 0.02


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


ONE = np.array([[330_000.0, 2_040_000.0]])


def offset_of(factor, **changes):
    return MapOffset.of(replace(stretches_at(ONE, [0.1], np.array([factor])), **changes))


@pytest.mark.parametrize(
    ("factor", "kind"),
    [
        (2.01, "map over 2 times too low"),
        (1.99, "map 1.5 to 2 times too low"),
        (1.49, "map 1.2 to 1.5 times too low"),
        (1.19, "map within a factor of 1.2"),
        (1.0, "map within a factor of 1.2"),
        (1 / 1.21, "map 1.2 to 1.5 times too high"),
        (1 / 1.51, "map 1.5 to 2 times too high"),
        (1 / 2.01, "map over 2 times too high"),
    ],
)
def test_the_kind_is_named_from_the_map(factor, kind):
    offset = offset_of(factor)
    assert offset.ratio == pytest.approx(1 / factor)
    assert OFF_KINDS[int(offset.kind[0])] == kind


@given(st.floats(1.01, 20.0), st.floats(1.01, 5.0))
def test_without_errors_of_measurement_the_interval_decides(factor, side):
    exact = {"measured_sd": np.zeros(1), "place_sd": np.zeros(1)}
    above = offset_of(factor, c_r_low=np.array([0.01]), c_r_high=np.array([0.1 * side]), **exact)
    assert above.beyond == pytest.approx((factor - 1) / (side - 1))
    below = offset_of(1 / factor, c_r_low=np.array([0.1 / side]), c_r_high=np.array([9.0]), **exact)
    assert below.beyond == pytest.approx((1 - 1 / factor) / (1 - 1 / side))


def test_errors_add_in_power():
    """80 % half widths, rad/m: 0.03 of the map, 0.04 of the measurement: a difference of 0.05 is just explained."""
    sd = np.array([0.04]) / 1.2815515655446004
    for place_sd, beyond in ((np.zeros(1), 1.0), (sd, 0.05 / np.sqrt(0.0041))):
        offset = offset_of(1.5, c_r_high=np.array([0.13]), measured_sd=sd, place_sd=place_sd)
        assert offset.beyond == pytest.approx(beyond)
    unknown = {"c_r_low": np.array([np.nan]), "c_r_high": np.array([np.nan])}  # of the map: the other errors remain
    assert [offset_of(factor, **unknown).is_off.tolist() for factor in (1.03, 1.3)] == [[False], [True]]


def test_the_share_that_errors_explain_is_that_of_the_agreement():
    stretches = made_up_check(200, noise=0.5, unknown=[3, 7]).stretches
    offset = MapOffset.of(stretches)
    explained = ~offset.is_off[np.isfinite(offset.ratio)]
    assert 0.0 < explained.mean() == agreement_of(stretches).inside < 1.0


@pytest.mark.parametrize("changes", [{"c_r": np.array([np.nan])}, {"measured": np.zeros(1)}])
def test_what_is_not_known_or_under_the_floor_is_not_compared(changes):
    offset = offset_of(1.0, **changes)
    assert offset.kind.tolist() == [NOT_COMPARED]
    assert np.isnan(offset.ratio).all()
    assert np.isnan(offset.beyond).all()
    assert not offset.is_off.any()
