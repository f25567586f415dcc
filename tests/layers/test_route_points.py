import json

import pytest
import shapely

from bumpymap.core import BadInputError
from bumpymap.layers import read_points
from bumpymap.layers.route_inputs import FilePoint

PLACES = [(-99.19, 19.318), (-99.1885, 19.3191), (-99.1881, 19.3178)]


def feature(geometry, **properties):
    return {"type": "Feature", "properties": properties, "geometry": shapely.geometry.mapping(geometry)}


def geojson(path, *features, **more):
    path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features)} | more))
    return path


def test_points_of_a_geojson_in_their_order(tmp_path):
    points = [shapely.Point(*place, 2250.0) for place in PLACES]
    path = geojson(
        tmp_path / "stops.geojson",
        feature(points[0], name="gate"),
        {"type": "Feature", "properties": {"name": "nowhere"}, "geometry": None},
        feature(points[1], number=7),
        feature(points[2], name=" pump "),
    )
    assert read_points(path) == [
        FilePoint("gate", *PLACES[0], "lonlat"),
        FilePoint("2", *PLACES[1], "lonlat"),
        FilePoint("pump", *PLACES[2], "lonlat"),
    ]
    nameless = geojson(tmp_path / "bare.json", feature(shapely.MultiPoint(PLACES)))
    assert [(point.name, point.x, point.y) for point in read_points(nameless)] == [
        (str(number), *place) for number, place in enumerate(PLACES, start=1)
    ]


def test_projected_numbers_and_names_that_are_no_text(tmp_path, caplog):
    points = [shapely.Point(480_000.0, 2_136_000.0), shapely.Point(480_050.0, 2_136_020.0)]
    path = geojson(tmp_path / "utm.geojson", feature(points[0], name=["a"]), feature(points[1], name=7))
    assert read_points(path) == [
        FilePoint("1", 480_000.0, 2_136_000.0, "crs"),
        FilePoint("7", 480_050.0, 2_136_020.0, "crs"),
    ]
    assert "cannot be degrees" in caplog.text


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
    ("name", "text", "words"),
    [
        ("a.csv", "lon,height\n1,2\n", r"a\.csv has the columns lon, height; it needs lon,lat"),
        ("a.csv", "lon,lat\n1,2\n3,north\n", r"a\.csv, line 3: '3,north'"),
        ("a.csv", "x;y\n1,5;2,5\n", r"'1,5;2,5' has no two numbers .* decimals with a point"),
        ("a.csv", "lon,lat\n1,nan\n", "has no two numbers"),
        ("a.csv", "lon,lat\n", "holds no points"),
        ("a.csv", "", r"columns \(none\)"),
        ("a.csv", b"\xff\xfe\x00", "cannot read"),
        ("a.txt", "1,2", r"Give \.geojson, \.gpx or \.csv"),
        ("a.geojson", "{", r"cannot read .*a\.geojson: .*\. Give"),
        ("a.geojson", "[1, 2]", "it is no GeoJSON: it is .*; it must be an object with type"),
        ("a.geojson", '{"type": "FeatureCollection", "features": [5]}', "features.0 is '5'; it must be an object"),
        ("a.geojson", '{"type": "Feature", "crs": 5}', "crs is '5'; it must be an object with type, properties"),
        ("a.geojson", '{"type": "Point", "coordinates": ["a", 1]}', "feature 1 has a position that is no two numbers"),
        ("a.geojson", '{"type": "Point", "coordinates": [1e999, 1]}', "feature 1 has a position that is no two numb"),
        ("a.geojson", '{"type": "Polygon", "coordinates": [[[1, 2]]]}', "a Polygon of it is damaged"),
        ("a.gpx", '<gpx><wpt lat="1"/></gpx>', "a point of it is not a place: lat='1'"),
        ("a.geojson", '{"type": "Point", "coordinates": {"a": 1}}', "cannot read"),
        ("a.gpx", "<gpx", "cannot read"),
        ("a.gpx", "<kml><wpt lat='1' lon='2'/></kml>", "it is no GPX"),
    ],
)
def test_files_that_are_no_points_are_refused(tmp_path, name, text, words):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(BadInputError, match=words):
        read_points(path)
