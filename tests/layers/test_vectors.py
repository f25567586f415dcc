"""Regions of a map and their files: what they cover, shared borders, RFC 7946; areas and points of users."""

import json
from dataclasses import replace

import geopandas
import numpy as np
import pandas as pd
import pytest
import shapely
from cost_maps import lone_columns, make_field, make_map, regions_of, table_of, write_flatgeobuf, write_geojson
from hypothesis import example, given, settings, strategies as st
from hypothesis.extra.numpy import arrays
from pyproj import CRS, Transformer
from route_maps import UTM, bare_map
from scipy import ndimage

from bumpymap.core import CLASS_NAMES, NO_CLASS, REASON_TEXT, BadInputError, Barred, Georeference, Reason
from bumpymap.layers import GeoJsonCoordinates, Placement, read_areas, read_points, tiles_in
from bumpymap.layers.route_inputs import FilePoint
from bumpymap.layers.vector import dissolve, region_columns
from bumpytiles import Grid, TileTable, TileWindow


def holes_of_tiles(col, row):
    """Holes in the union of tiles: what lies inside groups of tiles that share sides."""
    filled = np.zeros((np.ptp(row) + 1, np.ptp(col) + 1), dtype=bool)
    filled[row - row.min(), col - col.min()] = True
    groups, _ = ndimage.label(filled)
    boxes = enumerate(ndimage.find_objects(groups), start=1)
    return sum(ndimage.label(~np.pad(groups[box] == number, 1))[1] - 1 for number, box in boxes)


def check_coverage(polygons, holes=None):
    """Every polygon is valid, they fit together without a gap, and their union has as many holes as expected."""
    assert shapely.is_valid(polygons).all()
    assert shapely.coverage_is_valid(polygons)
    if holes is not None:
        whole = shapely.get_parts(shapely.coverage_union_all(polygons))
        assert shapely.get_num_interior_rings(whole).sum() == holes


KEYS = arrays(np.uint8, st.tuples(st.integers(1, 8), st.integers(1, 8)), elements=st.integers(0, 3)).filter(np.any)
CHECKERS = np.add.outer(np.arange(6), np.arange(7)).astype(np.uint8) % 2 + 1
DIAGONALS = np.array([[1, 0, 1], [0, 1, 0], [1, 0, 2], [0, 2, 0]], np.uint8)
RING_BY_CORNERS = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.uint8)
BESIDE_A_LONG_SIDE = np.array([[1, 1, 1, 1], [2, 2, 3, 3], [0, 2, 3, 0]], np.uint8)


SITES = {
    # name: (georeference, west tile, south tile)
    "south": (Georeference(CRS.from_epsg(32719)), 166_666, 2_000_000),
    "feet": (Georeference(CRS.from_epsg(2271), 1200 / 3937, 1200 / 3937), 130_000, 60_000),
    "northing_first": (Georeference(CRS.from_epsg(2193)), 530_000, 1_730_000),
    "far_north": (Georeference(CRS.from_epsg(32633)), 160_000, 2_920_000),
    "no_crs": (Georeference(None), -7, -5),
}


def map_of_keys(keys, site, stretch=1, shift=(0, 0)):
    """Map with a class for each key, every tile stretched to ``stretch`` tiles side by side."""
    georeference, west, south = SITES[site]
    wide = np.repeat(keys, stretch, axis=1)
    line, col = np.nonzero(wide)
    place = (col + west + shift[0], south + shift[1] - line)
    options = {"georeference": georeference, "easy": True, "grid": Grid(3.0, 1)}
    return make_map(*place, wide[line, col] - 1, np.zeros(len(col)), **options)


def vertices_by_hand(keys):
    """Corners of tiles, (y, x), but for those where one straight border passes, or none."""
    padded = np.pad(keys, 1)
    a, b, c, d = padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]
    return {*zip(*np.nonzero(~(((a == b) & (c == d)) | ((a == c) & (b == d)))), strict=True)}


@pytest.mark.parametrize("site", SITES)
@settings(max_examples=20)
@given(
    keys=KEYS,
    cut=st.sampled_from([(1, 1), (1, 3), (1, 512), (20, 512), (45, 512)]),
    shift=st.tuples(*[st.integers(-9, 9)] * 2),
)
@example(keys=CHECKERS, cut=(1, 512), shift=(-4, 0))
@example(keys=DIAGONALS, cut=(1, 512), shift=(0, 0))
@example(keys=RING_BY_CORNERS, cut=(1, 512), shift=(0, 0))
@example(keys=BESIDE_A_LONG_SIDE, cut=(45, 512), shift=(-80, 0))
@example(keys=np.ones((7, 8), np.uint8), cut=(1, 2), shift=(0, 0))
def test_both_vectors_are_a_coverage_with_the_holes_of_the_tiles(site, keys, cut, shift):
    stretch, size = cut
    made = map_of_keys(keys, site, stretch, shift)
    table, holes = table_of(made), holes_of_tiles(made.patches.col, made.patches.row)
    place = GeoJsonCoordinates.of(Placement.of(table), local=True)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("bumpymap.layers.vector.REGION_WINDOW", size)
        outlines = np.concatenate([regions.outlines for regions in dissolve(table)])
    check_coverage(shapely.transform(outlines, place.placement.to_crs), holes)
    if cut == (1, 512):  # no vertices but those that both sides need
        line, col = np.nonzero(keys)
        west, north = made.patches.col.min() - col.min(), made.patches.row.max() + 1 + line.min()
        x, y = shapely.get_coordinates(outlines).T.astype(int)
        assert {*zip((north - y).tolist(), (x - west).tolist(), strict=True)} == vertices_by_hand(keys)
    check_coverage(place.polygons(outlines), holes)


def test_numbers_are_means_over_the_tiles():
    made = make_map([0, 1, 0, 1, 5], [0, 0, 1, 1, 9], [2, 2, NO_CLASS, NO_CLASS, 2], [0, 0, 3, 4, 0])
    p_fail = np.array([0.1, 0.4, np.nan, np.nan, 0.5], np.float32)
    cost_map = replace(made, p_fail=p_fail, patches=replace(made.patches, slope=np.zeros(5)))
    regions = regions_of(cost_map)
    # North first: the lonely tile, then the two unknown ones (for different reasons), then the pair.
    columns, rough, none = region_columns(regions), CLASS_NAMES[2], None
    for name, wanted in {
        "tiles": [1, 1, 1, 2],
        "area_m2": [9.0, 9.0, 9.0, 18.0],
        "class": [2, none, none, 2],
        "class_name": [rough, "unknown", "unknown", rough],
        "reason": [none, REASON_TEXT[Reason(3)], REASON_TEXT[Reason(4)], none],
        "passable": [False, False, False, True],
        "c_r_basis": ["survivors", none, none, "drives"],
    }.items():
        assert columns[name] == wanted, name
    for name in ("c_r", "c_r_low", "c_r_high", "p_fail"):
        values = getattr(cost_map, name).astype(float)
        assert getattr(regions, name) == pytest.approx([values[4], np.nan, np.nan, values[:2].mean()], nan_ok=True)
    hazard = (-np.log([0.9, 0.6]) / cost_map.rule.drive_m).mean()
    cost = 1 + 2.5 * cost_map.c_r[:2].astype(float).mean() + 300 * hazard
    assert regions.hazard == pytest.approx([np.nan] * 3 + [hazard], nan_ok=True)
    assert regions.cost == pytest.approx([np.nan] * 3 + [cost], nan_ok=True)


def test_a_region_of_passable_tiles_lies_in_one_zone():
    cost_map = make_map(np.arange(6), np.zeros(6, int), [1] * 6, [0] * 6, easy=True)
    columns = lone_columns(cost_map) | {"zone": np.array([3, 3, 1, 1, 0, 3], np.int32)}
    columns["barred"][5] = Barred.STEP
    tiles = TileTable.of(cost_map.patches.grid, columns)
    (regions,) = dissolve(replace(table_of(cost_map), tiles=tiles))
    found = region_columns(regions)
    assert (found["tiles"], found["zone"], found["passable"]) == (
        [2, 2, 1, 1],
        [3, 1, None, None],
        [True] * 3 + [False],
    )


def check_rfc7946(path):
    """Hold a file against RFC 7946; the parsed collection comes back. Written apart from what it checks."""
    collection = json.loads(path.read_text(), parse_constant=pytest.fail)
    assert collection["type"] == "FeatureCollection"
    assert "crs" not in collection
    corners = []
    for feature in collection["features"]:
        assert (feature["type"], type(feature["properties"])) == ("Feature", dict)
        geometry = feature["geometry"]
        assert (set(geometry), geometry["type"]) == ({"type", "coordinates"}, "Polygon")
        assert all(ring[0] == ring[-1] for ring in geometry["coordinates"])
        shape = shapely.geometry.shape(geometry)
        assert shape.is_valid
        assert not shape.has_z
        assert shape.exterior.is_ccw
        assert not any(hole.is_ccw for hole in shape.interiors)
        corners.append(shapely.get_coordinates(shape))
    corners = np.concatenate(corners)
    np.testing.assert_array_equal(corners, np.round(corners, 7))
    assert (np.abs(corners) <= [180, 90]).all()
    assert collection["bbox"] == [*corners.min(axis=0), *corners.max(axis=0)]
    return collection


@pytest.fixture(name="site", params=["south", "feet", "northing_first", "far_north"])
def site_fixture(request):
    georeference, west, south = SITES[request.param]
    return make_field(40, 25, west=west, south=south, georeference=georeference)


def back_to_tiles(cost_map, outlines):
    """Longitude and latitude to tiles, by pyproj alone."""
    place = cost_map.georeference
    to_crs = Transformer.from_crs("OGC:CRS84", place.crs, always_xy=True)
    scale = place.metres_per_unit / cost_map.patches.grid.tile_size
    return shapely.transform(outlines, lambda p: np.column_stack(to_crs.transform(p[:, 0], p[:, 1])) * scale)


def test_properties(tmp_path, cost_map):
    write_geojson(regions_of(cost_map), tmp_path / "cost.geojson", local=False)
    found = [feature["properties"] for feature in check_rfc7946(tmp_path / "cost.geojson")["features"]]
    for got in found:
        assert list(got) == [
            *("region", "class", "class_name", "reason", "passable", "zone", "c_r", "c_r_low", "c_r_high"),
            *("c_r_basis", "p_fail", "hazard", "cost", "area_m2", "tiles"),
        ]
        assert got["passable"] == (got["cost"] is not None) == (got["hazard"] is not None)
        assert (got["class"] is None) == (got["c_r"] is None) == (got["reason"] is not None)
    assert {(got["class"] is None, got["passable"]) for got in found} == {(True, False), (False, True), (False, False)}
    assert sum(got["tiles"] for got in found) == len(cost_map.class_id)


def test_geojson_and_flatgeobuf_open_in_geopandas_where_the_tiles_are_with_the_same_values(tmp_path, site):
    regions = regions_of(site)
    write_geojson(regions, tmp_path / "cost.geojson", local=False, about={"vehicle": "warthog"})
    write_flatgeobuf(regions, tmp_path / "cost.fgb")
    collection = check_rfc7946(tmp_path / "cost.geojson")
    assert collection["vehicle"] == "warthog"
    assert [feature["id"] for feature in collection["features"]] == [*range(1, len(regions.tiles) + 1)]
    globe, flat = (geopandas.read_file(tmp_path / name) for name in ("cost.geojson", "cost.fgb"))
    assert (globe.crs.to_epsg(), flat.crs) == (4326, site.georeference.crs)
    found = back_to_tiles(site, globe.geometry.to_numpy())
    assert (shapely.hausdorff_distance(found, regions.outlines) * 3.0 < 0.02).all()  # m
    np.testing.assert_allclose(shapely.area(found) * 9.0, globe["area_m2"], rtol=0.02)
    assert flat.geometry.is_valid.all()
    assert flat.geometry.geom_type.unique().tolist() == ["Polygon"]
    unit = site.georeference.metres_per_unit
    assert flat.area.sum() * unit**2 == pytest.approx(9.0 * len(site.class_id), rel=1e-9)
    flat = flat.sort_values("region")  # FlatGeobuf stores features along a Hilbert curve
    boxes = flat.bounds[["minx", "miny", "maxx", "maxy"]].to_numpy() * unit
    np.testing.assert_allclose(boxes, shapely.bounds(regions.outlines) * 3.0, rtol=1e-12)
    tables = (pd.DataFrame(frame.drop(columns="geometry")).reset_index(drop=True) for frame in (flat, globe))
    pd.testing.assert_frame_equal(*tables, check_dtype=False, check_like=True)
    assert globe["passable"].dtype == flat["passable"].dtype == bool


def test_long_sides_follow_the_grid_on_the_globe(tmp_path):
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


def test_across_the_antimeridian_only_local_coordinates_are_written(tmp_path):
    place = Georeference(CRS.from_epsg(32701))
    x, y = Transformer.from_crs(4326, place.crs, always_xy=True).transform(180.0, -17.0)
    regions = regions_of(make_field(8, 6, west=round(x / 3) - 4, south=round(y / 3), georeference=place))
    with pytest.raises(BadInputError, match=r"antimeridian.*`local=True`"):
        write_geojson(regions, tmp_path / "cost.geojson", local=False)
    write_geojson(regions, tmp_path / "cost.geojson", local=True)
    assert geopandas.read_file(tmp_path / "cost.geojson").crs.equals(place.crs, ignore_axis_order=True)


def test_without_crs_only_local_coordinates_are_written(tmp_path):
    cost_map = make_field(8, 6, west=-3, south=-2, georeference=Georeference(None))
    regions, path = regions_of(cost_map), tmp_path / "cost.geojson"
    with pytest.raises(BadInputError, match=r"no CRS.*`crs='EPSG:CODE'`.*`local=True`"):
        write_geojson(regions, path, local=False)
    assert not path.exists()
    write_geojson(regions, path, local=True)
    write_flatgeobuf(regions, tmp_path / "cost.fgb")
    collection = json.loads(path.read_text())
    assert "not RFC 7946" in collection["local_coordinates"]
    assert collection["metres_per_unit"] == 1.0
    globe, flat = geopandas.read_file(path), geopandas.read_file(tmp_path / "cost.fgb")
    assert flat.crs is None
    assert flat.area.sum() == 9.0 * len(cost_map.class_id)
    assert (globe.crs.type_name, globe.crs.name) == ("Engineering CRS", "survey without a CRS")
    assert globe.crs.axis_info[0].unit_conversion_factor == 1.0
    bounds = (shapely.total_bounds(regions.outlines) * 3.0).tolist()
    assert collection["bbox"] == globe.total_bounds.tolist() == flat.total_bounds.tolist() == bounds


def test_coordinates_outside_of_the_crs(tmp_path):
    regions = regions_of(make_field(5, 5, west=300_000_000, south=300_000_000))
    with pytest.raises(BadInputError, match=r"outside the area where its CRS.*`force_crs="):
        write_geojson(regions, tmp_path / "cost.geojson", local=False)


# ---- areas and points of users ----


GRID = Grid(3.0, 15)
WINDOW = TileWindow(160_000, 712_000, 100, 80)
SITE = bare_map(WINDOW)
CORNER = np.array([480_000.0, 2_136_000.0])
"""South-west corner of the site, m."""


def on_site(west, south, east, north):
    """A box, in metres from that corner."""
    return shapely.box(*np.add(CORNER, (west, south)), *np.add(CORNER, (east, north)))


def feature(geometry, **properties):
    return {"type": "Feature", "properties": properties, "geometry": shapely.geometry.mapping(geometry)}


def geojson(path, *features, **more):
    path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features)} | more))
    return path


def blob(seed, *, middle=(150.0, 120.0), size=90.0, corners=9):
    """A star-shaped polygon on the site."""
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.random(corners)) * 2 * np.pi
    radius = size * (0.3 + 0.7 * rng.random(corners))
    return shapely.Polygon(CORNER + middle + np.column_stack([np.cos(angle), np.sin(angle)]) * radius[:, None])


def by_hand(areas, window, test):
    """The relation of every tile of a window to the areas."""
    col, row = np.meshgrid(window.col + np.arange(window.cols), window.row + np.arange(window.rows)[::-1])
    return test(shapely.union_all(areas), shapely.box(col * 3.0, row * 3.0, col * 3.0 + 3.0, row * 3.0 + 3.0))


@pytest.mark.parametrize("seed", range(3))
def test_tiles_in_and_within_areas_tile_by_tile(seed):
    areas = np.array([blob(seed), blob(seed + 50, middle=(250.0, 60.0), size=70.0), blob(seed + 70, size=2.0)])
    for window in (TileWindow(160_010, 712_005, 60, 55), TileWindow(160_045, 712_035, 3, 4)):
        touched, held = tiles_in(areas, window, GRID), tiles_in(areas, window, GRID, wholly=True)
        assert np.array_equal(
            touched, by_hand(areas, window, lambda a, b: shapely.intersects(a, b) & ~shapely.touches(a, b))
        )
        assert np.array_equal(held, by_hand(areas, window, shapely.covers))
        assert not (held & ~touched).any()


def test_sides_on_the_borders_of_tiles():
    """A polygon drawn along tiles touches no others; two such side by side hold the tiles of both."""
    area = on_site(30.0, 60.0, 90.0, 120.0)
    expected = np.zeros((80, 100), bool)
    expected[40:60, 10:30] = True
    halves = [on_site(30.0, 60.0, 61.0, 120.0), on_site(61.0, 60.0, 90.0, 120.0)]
    assert np.array_equal(tiles_in(np.array([area]), WINDOW, GRID), expected)
    assert np.array_equal(tiles_in(np.array([area]), WINDOW, GRID, wholly=True), expected)
    assert np.array_equal(tiles_in(np.array(halves), WINDOW, GRID, wholly=True), expected)
    for how in ({}, {"wholly": True}):
        assert not tiles_in(np.array([], object), WINDOW, GRID, **how).any()
        assert not tiles_in(np.array([area]), TileWindow(0, 0, 4, 4), GRID, **how).any()
        assert tiles_in(np.array([shapely.box(0, 0, 1e7, 1e7)]), WINDOW, GRID, **how).all()


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:32614", "EPSG:32613"])
def test_areas_of_any_crs_come_to_the_same_place(tmp_path, crs):
    area = blob(1)
    transformer = Transformer.from_crs(UTM, crs, always_xy=True)
    dense = shapely.segmentize(area, 0.5)  # a straight side is bent in another CRS
    moved = shapely.transform(dense, lambda xy: np.column_stack(transformer.transform(xy[:, 0], xy[:, 1])))
    stated = {"type": "name", "properties": {"name": crs}}
    (found,) = read_areas(geojson(tmp_path / "areas.geojson", feature(moved), crs=stated), SITE)
    assert found.symmetric_difference(area).area < 0.01 * area.length * 0.01  # 0.1 mm along the outline
    assert np.array_equal(tiles_in(np.array([found]), WINDOW, GRID), tiles_in(np.array([area]), WINDOW, GRID))


def test_a_side_that_is_straight_in_longitude_and_latitude_is_bent_on_the_grid(tmp_path):
    """A strip along a parallel, 2 degrees long: at its middle, its straight side on the grid would be 130 m off."""
    longitude, latitude = SITE.to_lonlat(480_150.0, 2_136_120.0)
    strip = shapely.box(longitude - 1.0, latitude, longitude + 1.0, latitude + 1.0)
    (found,) = read_areas(geojson(tmp_path / "a.geojson", feature(strip)), SITE)
    east = np.linspace(480_001.0, 480_299.0, 30)
    along = SITE.to_lonlat(east, np.full(30, 2_136_120.0))[0]
    edge = SITE.from_lonlat(along, np.full(30, latitude))[1]
    points = [shapely.points(east, edge + step) for step in (0.001, -0.001)]
    assert shapely.covers(found, points[0]).all()
    assert not shapely.covers(found, points[1]).any()


def test_areas_beside_the_map_are_an_error_that_names_them_unless_that_is_allowed(tmp_path, caplog):
    """A way leads through what an area in a wrong place was to close."""
    on, off = shapely.Point(SITE.to_lonlat(480_150.0, 2_136_120.0)).buffer(1e-4), shapely.Point(11.0, 48.0).buffer(1e-3)
    path = geojson(tmp_path / "a.geojson", feature(on, name="pit"), feature(off, name="pond"), feature(off))
    with pytest.raises(BadInputError, match=r"2 of the 3 areas of .* read in WGS 84 .*: number 2, 3\. .*allow_outside"):
        read_areas(path, SITE)
    assert len(read_areas(path, SITE, allow_outside=True)) == 1
    assert "number 2, 3" in caplog.text


def test_projected_numbers_of_a_geojson_are_in_the_crs_of_the_map(tmp_path, caplog):
    """Read as degrees they would lie nowhere, and the way would lead through."""
    area = blob(3)
    (found,) = read_areas(geojson(tmp_path / "a.geojson", feature(area)), SITE)
    assert found.equals(area)
    assert "cannot be degrees" in caplog.text
    beyond = geojson(tmp_path / "b.geojson", feature(shapely.box(4e6, 5e6, 4e6 + 9.0, 5e6 + 9.0)))
    with pytest.raises(BadInputError, match=r"read in .*EPSG:32614.*, do not lie on the map"):
        read_areas(beyond, SITE)


def test_a_map_without_a_crs_takes_areas_in_its_own_coordinates(tmp_path):
    local = bare_map(TileWindow(0, 0, 20, 20), crs=None)
    area = shapely.box(6.0, 6.0, 20.0, 30.0)
    (found,) = read_areas(geojson(tmp_path / "a.geojson", feature(area)), local)
    assert found.equals(area)


def areas(path):
    return read_areas(path, SITE)


PLACES = [(-99.19, 19.318), (-99.1885, 19.3191), (-99.1881, 19.3178)]


def test_points_of_a_geojson_in_their_order(tmp_path):
    points = [shapely.Point(*place, 2250.0) for place in PLACES]
    nowhere = {"type": "Feature", "properties": {"name": "nowhere"}, "geometry": None}
    features = feature(points[0], name="gate"), nowhere, feature(points[1], number=7), feature(points[2], name=" pump ")
    assert read_points(geojson(tmp_path / "stops.geojson", *features)) == [
        FilePoint(name, *place, "lonlat") for name, place in zip(("gate", "2", "pump"), PLACES, strict=True)
    ]
    nameless = geojson(tmp_path / "bare.json", feature(shapely.MultiPoint(PLACES)))
    assert read_points(nameless) == [FilePoint(str(n), *place, "lonlat") for n, place in enumerate(PLACES, start=1)]


GPX = '<?xml version="1.0"?><gpx version="1.1" creator="t" xmlns="http://www.topografix.com/GPX/1/1">{}</gpx>'


def test_waypoints_of_a_gpx_or_else_the_points_of_its_route(tmp_path):
    path = tmp_path / "tour.gpx"
    way = "".join(f'<wpt lat="{y}" lon="{x}"><ele>12</ele><name>w{i}</name></wpt>' for i, (x, y) in enumerate(PLACES))
    route = f'<rte><rtept lat="{PLACES[1][1]}" lon="{PLACES[1][0]}"></rtept></rte>'
    path.write_text(GPX.format(way + route))
    assert read_points(path) == [FilePoint(f"w{i}", *place, "lonlat") for i, place in enumerate(PLACES)]
    path.write_text(GPX.format(route))
    assert read_points(path) == [FilePoint("1", *PLACES[1], "lonlat")]
    path.write_text(GPX.format(""))
    with pytest.raises(BadInputError, match="holds no points"):
        read_points(path)


@pytest.mark.parametrize(
    ("head", "system", "separator"),
    [("lon,lat", "lonlat", ","), ("Longitude;Latitude", "lonlat", ";"), ("x\ty", "crs", "\t")],
)
def test_columns_of_a_csv(tmp_path, head, system, separator):
    path = tmp_path / "points.csv"
    rows = [["id", head, "name"], ["7", "1.5", "-2.25", "the gate"], [""], ["", ""], ["8", " 3e2 ", "4"]]
    path.write_text("\n".join(map(separator.join, rows)), encoding="utf-8-sig")
    assert read_points(path) == [FilePoint("the gate", 1.5, -2.25, system), FilePoint("4", 300.0, 4.0, system)]


@pytest.mark.parametrize(
    ("read", "name", "content", "words"),
    [
        (areas, "a.geojson", json.dumps(feature(shapely.LineString(PLACES))), "holds linestring; areas must be pol"),
        (areas, "a.geojson", '{"type": "FeatureCollection", "features": []}', "holds nothing"),
        (areas, "a.kml", "", "is not a file of polygons"),
        (areas, "a.gpkg", "SQLite format 3", "ogr2ogr"),
        (areas, "b.geojson", None, "is missing"),
        (read_points, "a.csv", "lon,height\n1,2\n", r"a\.csv has the columns lon, height; it needs lon,lat"),
        (read_points, "a.csv", "lon,lat\n1,2\n3,north\n", r"a\.csv, line 3: '3,north'"),
        (read_points, "a.csv", "x;y\n1,5;2,5\n", r"'1,5;2,5' has no two numbers .* decimals with a point"),
        (read_points, "a.csv", "lon,lat\n", "holds no points"),
        (read_points, "a.csv", b"\xff\xfe\x00", "cannot read"),
        (read_points, "a.txt", "1,2", r"Give \.geojson, \.gpx or \.csv"),
        (read_points, "a.geojson", "{", r"cannot read .*a\.geojson: .*\. Give"),
        (
            read_points,
            "a.geojson",
            '{"type": "FeatureCollection", "features": [5]}',
            "features.0 is '5'; it must be an ",
        ),
        (read_points, "a.geojson", '{"type": "Feature", "crs": 5}', "crs is '5'; it must be an object with type, prop"),
        (read_points, "a.geojson", '{"type": "Point", "coordinates": [1e999, 1]}', "the Point of feature 1 is damaged"),
        (read_points, "a.geojson", '{"type": "Polygon", "coordinates": [[[1, 2]]]}', "Polygon of feature 1 is damaged"),
        (read_points, "a.gpx", '<gpx><wpt lat="1"/></gpx>', "a point of it is not a place: lat='1'"),
        (read_points, "a.gpx", "<kml><wpt lat='1' lon='2'/></kml>", "it is no GPX"),
    ],
)
def test_files_that_hold_neither_areas_nor_points_are_refused(tmp_path, read, name, content, words):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(BadInputError, match=words):
        read(path)


def areas_by_hand(cost_map):
    """Unions of the boxes of tiles that share sides and what they are, found apart from the package."""
    patches, known = cost_map.patches, cost_map.class_id != NO_CLASS
    passable = known & (cost_map.p_fail < 0.5) & (patches.slope <= cost_map.rule.slope_limit_deg)
    kind = np.stack([cost_map.class_id, np.where(known, 0, patches.reason), passable], axis=1).astype(int)
    boxes = shapely.box(patches.col, patches.row, patches.col + 1, patches.row + 1)
    for key in np.unique(kind, axis=0):
        for area in shapely.get_parts(shapely.union_all(boxes[(kind == key).all(axis=1)])):
            yield tuple(key.tolist()), area


@settings(max_examples=60)
@given(
    cells=st.lists(st.sampled_from([None, 0, 1, NO_CLASS]), min_size=1, max_size=36).filter(
        lambda cells: any(cell is not None for cell in cells)
    ),
    cols=st.integers(1, 6),
)
def test_any_small_map_gives_valid_right_hand_regions(cells, cols):
    present = [(i % cols - 3, i // cols - 3, cell) for i, cell in enumerate(cells) if cell is not None]
    col, row, class_id = zip(*present, strict=True)
    cost_map = make_map(col, row, class_id, [3 if cell == NO_CLASS else 0 for cell in class_id])
    regions = regions_of(cost_map)
    got = list(zip(regions.class_id, regions.reason, regions.passable, regions.outlines, strict=True))
    expected = list(areas_by_hand(cost_map))
    assert len(expected) == len(got)
    for key, area in expected:
        assert sum((k, r, p) == key and shapely.equals(area, outline) for k, r, p, outline in got) == 1
    assert shapely.is_valid(regions.outlines).all()
    for outline in regions.outlines:
        assert outline.exterior.is_ccw
        assert not any(hole.is_ccw for hole in outline.interiors)
