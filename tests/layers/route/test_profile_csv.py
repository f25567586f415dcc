"""profile.csv: the numbers of the profile, empty where unknown."""

import csv

import numpy as np
import pytest
from pyproj import CRS, Transformer
from route_records import UTM, make_route

from bumpymap.core import Georeference
from bumpymap.layers.route_lines import PROFILE_COLUMNS, write_profile


def table_of(path):
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == PROFILE_COLUMNS
    return rows


def numbers(rows, name):
    return np.array([float(row[name]) if row[name] else np.nan for row in rows])


@pytest.mark.parametrize("georeference", [UTM, Georeference(CRS.from_epsg(32614), 0.5)])
def test_every_number_of_the_profile_is_there(georeference, tmp_path):
    route = make_route(georeference=georeference)
    write_profile([route], tmp_path / "profile.csv")
    rows, profile = table_of(tmp_path / "profile.csv"), route.profile
    expected = {
        "distance_m": profile.distance,
        "x": profile.easting / georeference.metres_per_unit,
        "y": profile.northing / georeference.metres_per_unit,
        "z_m": profile.z,
        "slope_deg": profile.slope,
        "cost_m": profile.cost,
        "obstacle": profile.obstacle,
        **{name: getattr(profile, name) for name in ("c_r", "c_r_low", "c_r_high", "p_fail")},
    }
    for name, values in expected.items():
        np.testing.assert_allclose(numbers(rows, name), values, atol=6e-4 if name[:2] not in {"c_", "p_"} else 6e-7)
    assert np.isnan(expected["c_r"]).any()
    back = Transformer.from_crs(CRS.from_epsg(4326), georeference.crs, always_xy=True)
    x, y = back.transform(numbers(rows, "lon"), numbers(rows, "lat"))
    np.testing.assert_allclose(np.column_stack([x, y]), np.column_stack([expected["x"], expected["y"]]), atol=0.015)


def test_without_a_crs_longitude_and_latitude_are_empty(tmp_path):
    write_profile([make_route(georeference=Georeference(None))], tmp_path / "profile.csv")
    rows = table_of(tmp_path / "profile.csv")
    assert {(row["lon"], row["lat"]) for row in rows} == {("", "")}
    assert all(row["x"] for row in rows)
