"""Routes from Python, on layers of a made-up site."""

import numpy as np
import pytest
import xarray
from route_maps import write_folder
from route_sites import ROWS, SOUTH, WEST, place, site

import bumpymap


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
    with pytest.raises(bumpymap.UsageError, match="unknown setting speed"):
        bumpymap.find_routes(layers, *ends, speed=3)
    with pytest.raises(bumpymap.UsageError, match="it must be a path"):
        bumpymap.find_routes([layers.folder, layers.folder], *ends)


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
