import json

import geopandas
import numpy as np
import pandas as pd
import pytest
import shapely
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError
from region_files import regions_of, write_flatgeobuf, write_geojson

from bumpymap.core.errors import BadInputError
from bumpymap.core.types import CLASS_NAMES, CostTable, Georeference
from bumpymap.layers.regions import dissolve
from bumpymap.layers.vector import GeoJsonCoordinates, flatgeobuf_writer, geojson_writer

US_FOOT = 1200 / 3937
SITES = {
    # name: (georeference, west tile, south tile)
    "south": (Georeference(CRS.from_epsg(32719)), 166_666, 2_000_000),
    "feet": (Georeference(CRS.from_epsg(2271), US_FOOT, US_FOOT), 130_000, 60_000),
    "northing_first": (Georeference(CRS.from_epsg(2193)), 530_000, 1_730_000),
    "far_north": (Georeference(CRS.from_epsg(32633)), 160_000, 2_920_000),
}


def check_rfc7946(path):
    """Hold a file against RFC 7946; the parsed collection comes back. Written apart from what it checks."""
    collection = json.loads(path.read_text(), parse_constant=pytest.fail)
    assert collection["type"] == "FeatureCollection"
    assert "crs" not in collection
    corners = []
    for feature in collection["features"]:
        assert (feature["type"], type(feature["properties"])) == ("Feature", dict)
        geometry = feature["geometry"]
        assert set(geometry) == {"type", "coordinates"}
        polygons = {"Polygon": [geometry["coordinates"]], "MultiPolygon": geometry["coordinates"]}[geometry["type"]]
        assert all(ring[0] == ring[-1] for rings in polygons for ring in rings)
        shape = shapely.geometry.shape(geometry)
        assert shape.is_valid
        assert not shape.has_z
        for part in shapely.get_parts(shape):
            assert part.exterior.is_ccw
            assert not any(hole.is_ccw for hole in part.interiors)
            assert np.ptp(part.exterior.xy[0]) < 180
        corners.append(shapely.get_coordinates(shape))
    corners = np.concatenate(corners)
    np.testing.assert_array_equal(corners, np.round(corners, 7))
    assert (np.abs(corners) <= [180, 90]).all()
    lon, lat = corners.T
    west, south, east, north = collection["bbox"]
    assert (south, north) == (lat.min(), lat.max())
    assert (west, east) == ((lon.min(), lon.max()) if west <= east else (lon[lon > 0].min(), lon[lon < 0].max()))
    return collection


@pytest.fixture(name="site", params=SITES)
def site_fixture(request, make_field):
    georeference, west, south = SITES[request.param]
    return make_field(40, 25, west=west, south=south, georeference=georeference)


def back_to_tiles(cost_map, outlines):
    """Longitude and latitude to tiles, by pyproj alone."""
    place = cost_map.georeference
    to_crs = Transformer.from_crs("OGC:CRS84", place.crs, always_xy=True)
    scale = place.metres_per_unit / cost_map.patches.grid.tile_size
    return shapely.transform(outlines, lambda p: np.column_stack(to_crs.transform(p[:, 0], p[:, 1])) * scale)


def test_geojson_holds_the_standard_and_the_place(tmp_path, site):
    regions = regions_of(site)
    write_geojson(regions, tmp_path / "cost.geojson", local=False, about={"vehicle": "warthog"})
    collection = check_rfc7946(tmp_path / "cost.geojson")
    assert collection["vehicle"] == "warthog"
    numbers = [(feature["id"], feature["properties"]["region"]) for feature in collection["features"]]
    assert numbers == [(number, number) for number in range(1, len(regions.tiles) + 1)]
    found = back_to_tiles(site, [shapely.geometry.shape(feature["geometry"]) for feature in collection["features"]])
    assert (shapely.hausdorff_distance(found, regions.outlines) * 3.0 < 0.02).all()  # m
    areas = [feature["properties"]["area_m2"] for feature in collection["features"]]
    np.testing.assert_allclose(shapely.area(found) * 9.0, areas, rtol=0.02)


NAMES = ["region", "class", "class_name", "reason", "passable", "c_r", "c_r_low", "c_r_high", "c_r_basis"]
NAMES += ["p_fail", "hazard", "cost", "area_m2", "tiles"]


def test_properties(tmp_path, cost_map):
    write_geojson(regions_of(cost_map), tmp_path / "cost.geojson", local=False)
    collection = check_rfc7946(tmp_path / "cost.geojson")
    rule, seen = cost_map.rule, set()
    for feature in collection["features"]:
        got = feature["properties"]
        assert list(got) == NAMES
        assert got["area_m2"] == got["tiles"] * 9.0
        seen.add((got["class"] is None, got["passable"]))
        if got["class"] is None:
            assert (got["class_name"], got["c_r"], got["c_r_basis"], got["p_fail"]) == ("unknown", None, None, None)
            assert got["reason"] in {"too few points", "too many holes", "no ground points", "outlier-only relief"}
        else:
            assert (got["class_name"], got["reason"]) == (CLASS_NAMES[got["class"]], None)
            assert got["c_r_low"] <= got["c_r"] <= got["c_r_high"]
            assert got["c_r_basis"] == ("survivors" if got["p_fail"] >= 0.5 else "drives")
        if got["passable"]:
            cost = 1 + rule.ride_weight * got["c_r"] + rule.fail_weight * got["hazard"]
            assert got["p_fail"] < 0.5
            assert got["cost"] == pytest.approx(cost, abs=5e-6)
        else:
            assert (got["cost"], got["hazard"]) == (None, None)
    assert seen == {(True, False), (False, True), (False, False)}
    assert sum(feature["properties"]["tiles"] for feature in collection["features"]) == len(cost_map.class_id)


def test_geojson_and_flatgeobuf_open_in_geopandas_with_the_same_values(tmp_path, site):
    regions = regions_of(site)
    write_geojson(regions, tmp_path / "cost.geojson", local=False)
    write_flatgeobuf(regions, tmp_path / "cost.fgb")
    globe, flat = (geopandas.read_file(tmp_path / name) for name in ("cost.geojson", "cost.fgb"))
    assert globe.crs.to_epsg() == 4326
    assert flat.crs.equals(site.georeference.crs)
    assert flat.geometry.is_valid.all()
    assert flat.geometry.geom_type.unique().tolist() == ["Polygon"]
    unit = site.georeference.metres_per_unit
    assert flat.area.sum() * unit**2 == pytest.approx(9.0 * len(site.class_id), rel=1e-9)
    assert len(globe) == len(regions.tiles)
    flat = flat.sort_values("region")  # FlatGeobuf stores features along a Hilbert curve
    boxes = flat.bounds[["minx", "miny", "maxx", "maxy"]].to_numpy() * unit
    np.testing.assert_allclose(boxes, shapely.bounds(regions.outlines) * 3.0, rtol=1e-12)
    tables = (pd.DataFrame(frame.drop(columns="geometry")).reset_index(drop=True) for frame in (flat, globe))
    pd.testing.assert_frame_equal(*tables, check_dtype=False, check_like=True)
    assert globe["passable"].dtype == flat["passable"].dtype == bool


def test_long_sides_follow_the_grid_on_the_globe(tmp_path, make_map):
    # Far from the central meridian and far north, a strip of 3 km: its sides bend on the way to degrees.
    col, row = np.meshgrid(np.arange(240_000, 241_000), [2_900_000, 2_900_001])
    cost_map = make_map(
        *(col.ravel(), row.ravel(), np.zeros(2000), np.zeros(2000)),
        georeference=Georeference(CRS.from_epsg(32633)),
        easy=True,
    )
    regions = regions_of(cost_map)
    write_geojson(regions, tmp_path / "cost.geojson", local=False)
    (feature,) = check_rfc7946(tmp_path / "cost.geojson")["features"]
    ring = np.array(feature["geometry"]["coordinates"][0])
    middles = shapely.LineString((ring[:-1] + ring[1:]) / 2)  # where a straight piece is farthest from the true side
    found = shapely.get_coordinates(back_to_tiles(cost_map, middles))
    off = np.abs(found[:, 1] - np.round(found[:, 1])) * 3.0
    along = np.abs(found[:, 0] - np.round(found[:, 0] / 1000) * 1000) > 1.0
    assert off[along].max() < 0.012  # m: the rounding to 7 decimals is 1 cm


def test_antimeridian_is_cut(tmp_path, make_map):
    place = Georeference(CRS.from_epsg(32701))  # UTM zone 1 south, with Fiji; its western edge is the antimeridian
    x, _ = Transformer.from_crs(4326, 32701, always_xy=True).transform(180.0, -17.0)
    x, y = Transformer.from_crs(4326, 32701, always_xy=True).transform(-180.0, -17.0)
    middle, row = int(x // 3), int(y // 3)
    tiles = (np.arange(middle - 4, middle + 5), [row] * 9, [1] * 8 + [0], [0] * 9)
    cost_map = make_map(*tiles, georeference=place, easy=True)
    write_geojson(regions_of(cost_map), tmp_path / "cost.geojson", local=False)
    collection = check_rfc7946(tmp_path / "cost.geojson")
    assert [feature["geometry"]["type"] for feature in collection["features"]] == ["MultiPolygon", "Polygon"]
    west, _, east, _ = collection["bbox"]
    assert 179.99 < west < 180.0
    assert -180.0 < east < -179.99
    parts = shapely.geometry.shape(collection["features"][0]["geometry"]).geoms
    tile = 3.0 / (111_320 * np.cos(np.radians(17.0)))
    assert sum(np.ptp(part.exterior.xy[0]) for part in parts) == pytest.approx(8 * tile, rel=0.01)


def test_without_crs_only_local_coordinates_are_written(tmp_path, make_field):
    cost_map = make_field(8, 6, west=-3, south=-2, georeference=Georeference(None))
    regions, path = regions_of(cost_map), tmp_path / "cost.geojson"
    with pytest.raises(BadInputError, match=r"no CRS.*`crs='EPSG:CODE'`.*`local=True`"):
        write_geojson(regions, path, local=False)
    assert not path.exists()
    write_geojson(regions, path, local=True)
    collection = json.loads(path.read_text())
    assert "not RFC 7946" in collection["local_coordinates"]
    assert collection["metres_per_unit"] == 1.0
    assert collection["bbox"] == (shapely.total_bounds(regions.outlines) * 3.0).tolist()
    write_flatgeobuf(regions, tmp_path / "cost.fgb")
    flat = geopandas.read_file(tmp_path / "cost.fgb")
    assert flat.crs is None
    assert flat.area.sum() == 9.0 * len(cost_map.class_id)
    globe = geopandas.read_file(path)
    assert (globe.crs.type_name, globe.crs.name) == ("Engineering CRS", "survey without a CRS")
    assert globe.crs.axis_info[0].unit_conversion_factor == 1.0
    with pytest.raises(ProjError):
        globe.to_crs(4326)
    assert globe.total_bounds.tolist() == flat.total_bounds.tolist()


def test_coordinates_outside_of_the_crs(tmp_path, make_field):
    regions = regions_of(make_field(5, 5, west=300_000_000, south=300_000_000))
    with pytest.raises(BadInputError, match=r"outside the area where its CRS.*`force_crs="):
        write_geojson(regions, tmp_path / "cost.geojson", local=False)


def test_regions_fed_bit_by_bit_make_the_same_files(tmp_path, make_field, monkeypatch):
    table = CostTable.of(make_field(30, 20, west=166_600))
    for name, most in {"whole": 10_000, "bits": 5}.items():
        monkeypatch.setattr("bumpymap.layers.regions.BATCH", most)
        batches = list(dissolve(table))
        place = batches[0].placement
        with (
            geojson_writer(tmp_path / f"{name}.geojson", GeoJsonCoordinates.of(place, local=False)) as to_globe,
            flatgeobuf_writer(tmp_path / f"{name}.fgb", place) as to_flat,
        ):
            for regions in batches:
                to_globe(regions)
                to_flat(regions)
    for kind in ("geojson", "fgb"):
        assert (tmp_path / f"whole.{kind}").read_bytes() == (tmp_path / f"bits.{kind}").read_bytes()
    assert len(list(tmp_path.iterdir())) == 4
