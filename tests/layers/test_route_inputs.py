"""Areas and points of users, of any format and CRS."""

import json
from contextlib import nullcontext

import numpy as np
import pytest
import shapely
from pyogrio.raw import write
from pyproj import CRS, Transformer
from route_maps import UTM, bare_map

from bumpymap.core import BadInputError
from bumpymap.layers import read_areas, read_points, tiles_in
from bumpymap.layers.route_inputs import FilePoint
from bumpytiles import Grid, TileWindow

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


def save(path, area, crs):
    """Write a polygon with a CRS (None: without one)."""
    wkb, names = shapely.to_wkb(np.array([area], object)), [np.array(["area"], object)]
    warned = nullcontext() if crs else pytest.warns(UserWarning, match="'crs' was not provided")
    with warned:
        write(path, wkb, names, np.array(["name"]), geometry_type="Polygon", crs=crs and CRS(crs).to_wkt())
    return path


@pytest.mark.parametrize(
    ("suffix", "crs"),
    [(".gpkg", "EPSG:4326"), (".fgb", "EPSG:32614"), (".shp", "EPSG:32613"), (".geojson", "EPSG:4326")],
)
def test_areas_of_any_format_and_crs_come_to_the_same_place(tmp_path, suffix, crs):
    area = blob(1)
    transformer = Transformer.from_crs(UTM, crs, always_xy=True)
    dense = shapely.segmentize(area, 0.5)  # a straight side is bent in another CRS
    moved = shapely.transform(dense, lambda xy: np.column_stack(transformer.transform(xy[:, 0], xy[:, 1])))
    (found,) = read_areas(save(tmp_path / f"areas{suffix}", moved, crs), SITE)
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
    for path in (geojson(tmp_path / "a.geojson", feature(area)), save(tmp_path / "a.fgb", area, None)):
        (found,) = read_areas(path, local)
        assert found.equals(area)
    with pytest.raises(BadInputError, match="the map has no CRS"):
        read_areas(save(tmp_path / "b.fgb", area, "EPSG:32614"), local)
    with pytest.raises(BadInputError, match="states no CRS"):
        read_areas(tmp_path / "a.fgb", SITE)


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
        (areas, "a.gpkg", "no database", "cannot read"),
        (areas, "b.shp", None, "is missing"),
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
