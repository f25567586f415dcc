"""STAC's items and collections by its schemas, and files of routes, checks and scans: read back by others, true."""

import hashlib
import json
import shutil
import socket
from dataclasses import replace
from functools import cache
from pathlib import Path
from xml.etree import ElementTree as ET

import laspy
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pystac
import pytest
import rasterio
import shapely
from check_records import STRETCH_M, made_up_check, stretches_at
from cost_maps import make_field, table_of
from hypothesis import given, settings, strategies as st
from jsonschema import Draft7Validator
from PIL import Image
from point_files import read_vertices
from pyogrio.raw import read
from pyproj import CRS, Transformer
from referencing import Registry, Resource
from referencing.jsonschema import DRAFT7
from route_maps import RUN
from small_surveys import files_in
from tile_maps import CORNERS, FIGURES, UTM, MadeUpMap, make_route

from bumpymap.check.pipeline import agreement_of
from bumpymap.core import CLASS_NAMES, BadInputError, Frame, Georeference, OutputError, SeenSizes, sector_bounds
from bumpymap.layers import PRODUCT_NAMES, MapOffset, Placement, move_products, open_accumulated, open_map, sector_rows
from bumpymap.layers.check_files import NOT_COMPARED, OFF_KINDS, place_stretches, write_stretches
from bumpymap.layers.folder import write_products
from bumpymap.layers.route_files import PROFILE_COLUMNS, track_points, write_gpx, write_profile, write_route_geojson
from bumpymap.layers.scan_folder import COLUMNS, SCAN_COLOURS, check_scan_folder, name_frames, open_table, write_cloud
from bumpymap.layers.stac import write_collection, write_item
from bumpymap.views import write_map_views

SCHEMAS = Path(__file__).resolve().parents[1] / "layers" / "stac" / "schemas"
CORE = "https://schemas.stacspec.org/v1.1.0/{0}-spec/json-schema/{0}.json"


@cache
def registry():
    """All schemas by their ids; whoever asks for another one gets an error."""
    found = []
    for path in sorted(SCHEMAS.rglob("*.json")):
        schema = json.loads(path.read_text(encoding="utf-8"))
        resource = Resource.from_contents(schema, default_specification=DRAFT7)
        found.append((schema["$id"].rstrip("#"), resource))
        if path.name == "common.json":  # its own id lacks the dot
            found.append((schema["$id"].replace("commonjson", "common.json"), resource))
    return Registry().with_resources(found)


def faults(document):
    """What is wrong with an item or a collection, by the schemas of STAC and of the extensions that it names.

    ``eo`` has one field here, names of bands, which the tests read themselves.
    """
    kind = {"Feature": "item", "Collection": "collection"}[document["type"]]
    names = [CORE.format(kind), *(name for name in document.get("stac_extensions", []) if "/eo/" not in name)]
    return [
        f"{name}: {'/'.join(map(str, error.absolute_path))}: {error.message[:300]}"
        for name in names
        for error in Draft7Validator(
            registry().contents(name), registry=registry(), format_checker=Draft7Validator.FORMAT_CHECKER
        ).iter_errors(document)
    ]


RUN = RUN | {"inputs": [{"path": "/some/where/old quarry (1).laz"}]}
SURVEY = {"name": "Grube Süd", "checksum": "blake3:00", "dates": ["2024-05-03", "2024-05-04"]}


def item_of(folder):
    return json.loads((folder / "item.json").read_text(encoding="utf-8"))


def write(cost_map, folder, *, local=False, **entries):
    folder.mkdir()
    write_products(table_of(cost_map), folder, views=write_map_views, local=local, manifest=RUN | entries)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory, cost_map):
    return write(cost_map, tmp_path_factory.mktemp("stac") / "layers", survey=SURVEY)


@pytest.fixture(name="item")
def item_fixture(folder):
    return item_of(folder)


def described(folder, place, **entries):
    """The item of the same layers where run.json has other entries."""
    record = json.loads((folder / "run.json").read_text(encoding="utf-8")) | entries
    shutil.copytree(folder, place)
    site = open_map(folder)
    write_item(place, record, Placement(site.georeference, site.grid, site.window))
    return item_of(place)


def assets_with(item, key):
    return {name: asset for name, asset in item["assets"].items() if key in asset}


def test_an_item_is_valid_and_every_file_an_asset_with_its_size_and_checksum(item, folder):
    assert faults(item) == []
    assert "/some" not in json.dumps(item)  # where the survey lies
    assert {name.split("/")[3] for name in item["stac_extensions"]} == {"projection", "file", "processing", "eo"}
    present = {path: f"./{path}" for path in files_in(folder) if path != "item.json"}
    assert sorted(asset["href"] for asset in item["assets"].values()) == sorted(present.values())
    assert not any("." in name for name in item["assets"])  # odc-stac takes what follows a dot for a band
    with_checksum = assets_with(item, "file:checksum")
    assert {asset["href"] for asset in with_checksum.values()} == {
        present[path] for path in PRODUCT_NAMES if path not in {"item.json", "run.json"}
    }
    for asset in with_checksum.values():
        content = (folder / asset["href"]).read_bytes()
        assert asset["file:size"] == len(content)
        assert bytes.fromhex(asset["file:checksum"]) == b"\x12\x20" + hashlib.sha256(content).digest()
        assert asset["roles"] == ["data"]
    roles = {name: asset["roles"] for name, asset in item["assets"].items() if name not in with_checksum}
    assert roles["run_json"] == roles["class_qml"] == ["metadata"]
    assert roles["map_qgs"] == roles["report_html"] == ["overview"]
    assert roles["thumbnail"] == ["thumbnail"]
    with Image.open(folder / item["assets"]["thumbnail"]["href"]) as picture:
        assert picture.format == "JPEG"
        assert 64 < max(picture.size) <= 700


def test_rasters_are_described_as_they_are(item, folder):
    rasters = {Path(name).stem: folder / name for name in PRODUCT_NAMES if name.endswith(".tif")}
    assert set(assets_with(item, "proj:shape")) == set(rasters)
    for name, asset in assets_with(item, "proj:shape").items():
        with rasterio.open(rasters[name]) as raster:
            assert asset["proj:shape"] == list(raster.shape)
            assert asset["proj:transform"] == list(raster.transform)[:6]
            assert asset["proj:bbox"] == list(raster.bounds)
            assert asset["title"] == raster.tags()["title"]
            names = [band["name"] for band in asset["bands"]]
            assert names == [band["name"] for band in asset["eo:bands"]] == list(raster.descriptions)
            assert [band.get("unit") for band in asset["bands"]] == list(raster.units)
            assert asset["data_type"] == raster.dtypes[0]
            assert float(asset["nodata"]) == pytest.approx(raster.nodata, nan_ok=True)


def test_the_footprint_is_the_raster_in_longitude_and_latitude(item, folder):
    outline = shapely.geometry.shape(item["geometry"])
    with rasterio.open(folder / "rasters/class.tif") as raster:
        edge = shapely.segmentize(shapely.box(*raster.bounds).exterior, 1.0)
        to_degrees = Transformer.from_crs(raster.crs, 4326, always_xy=True)
    found = np.column_stack(to_degrees.transform(*shapely.get_coordinates(edge).T))
    assert shapely.distance(shapely.points(found), outline.exterior).max() < 1e-6
    assert item["bbox"] == pytest.approx(outline.bounds, abs=1e-9)
    assert item["bbox"] == pytest.approx([*found.min(axis=0), *found.max(axis=0)], abs=1e-6)
    assert item["properties"]["proj:code"] == "EPSG:32614"
    assert "proj:wkt2" not in item["properties"]


def test_name_dates_vehicle_and_software(item):
    properties = item["properties"]
    wanted = {"title": "Grube Süd", "gsd": 3, "datetime": None, "bumpymap:dates_known": True}
    wanted |= {"start_datetime": "2024-05-03T00:00:00Z", "end_datetime": "2024-05-04T23:59:59Z"}
    wanted |= {"bumpymap:vehicle": "warthog", "bumpymap:calibration": "c0ffee"}
    wanted |= {"bumpymap:class_limits": [0.1, 0.2, 0.4], "bumpymap:survey_checksum": "blake3:00"}
    assert {name: properties[name] for name in wanted} == wanted
    assert {"bumpymap", "GDAL", "PROJ"} == set(properties["processing:software"])
    assert [item["assets"][name]["gsd"] for name in ("heightmap", "relief")] == [0.2, 1.0]


@pytest.mark.parametrize("dates", [None, ["", ""], ["2024-13-01", "2024-01-01"]])
def test_unknown_dates_are_any_time_and_said_to_be_unknown(folder, tmp_path, dates):
    item = described(folder, tmp_path / "a", survey=SURVEY | {"dates": dates})
    properties = item["properties"]
    assert properties["bumpymap:dates_known"] is False
    assert properties["start_datetime"] == "1970-01-01T00:00:00Z"
    assert properties["end_datetime"] == "2099-12-31T23:59:59Z"
    assert faults(item) == []


def test_surveys_of_one_name_have_ids_of_their_own(folder, tmp_path):
    """A catalogue of them would hold one item, for programs that find items by their ids."""
    surveys = [SURVEY | {"checksum": f"blake3:{digit * 64}"} for digit in "ab"]
    items = [described(folder, tmp_path / str(number), survey=survey) for number, survey in enumerate(surveys)]
    assert [item["id"] for item in items] == ["Grube-S-d_aaaaaaaa", "Grube-S-d_bbbbbbbb"]
    assert [faults(item) for item in items] == [[]] * len(items)


def item_at(folder, crs, west=110_000, south=680_000, unit=1.0):
    """A valid item of a small map in some place."""
    place = Georeference(crs and CRS(crs), unit, unit)
    field = make_field(9, 7, west=west, south=south, georeference=place)
    item = item_of(write(field, folder / "map", local=crs is None))
    assert faults(item) == []
    return item


def test_a_survey_without_a_crs_has_no_geometry(tmp_path):
    item = item_at(tmp_path, None)
    assert item["geometry"] is None
    assert "bbox" not in item
    assert item["properties"]["proj:code"] is None
    assert item["properties"]["proj:shape"] == [7, 9]


def test_heights_of_a_compound_crs(tmp_path):
    item = item_at(tmp_path, "EPSG:6339+5703", 166_000, 1_400_000)  # UTM zone 10N, heights in metres
    assert item["properties"]["proj:code"] == "EPSG:6339"
    compound = {name: asset for name, asset in item["assets"].items() if "proj:code" in asset}
    assert set(compound) == {"heightmap", "relief", "tiles_parquet"}
    for asset in compound.values():
        assert asset["proj:code"] is None
        assert CRS.from_wkt(asset["proj:wkt2"]).is_compound


def test_feet(tmp_path):
    item = item_at(tmp_path, "EPSG:2263", 100_000, 20_000, 1200 / 3937)
    assert item["properties"]["gsd"] == item["assets"]["class"]["gsd"] == 3
    assert item["properties"]["proj:transform"][0] == pytest.approx(3 * 3937 / 1200)
    assert shapely.geometry.shape(item["geometry"]).area > 0


@pytest.fixture(scope="module")
def night(tmp_path_factory):
    root = tmp_path_factory.mktemp("night")
    for seed, name in enumerate(("a", "Grube Süd")):
        survey = {"name": name, "checksum": None, "dates": ["2024-05-03"] * 2 if seed else None}
        rights = {"rating": "ride", "provider": "" if seed else "Pits & Co", "license": "CC-BY-4.0"}
        page = {"operator": "Pits & Co" if seed else "another"}  # says it too
        write(make_field(9, 7, seed=seed), root / name, survey=survey, settings=rights, page=page)
    (root / "failed").mkdir()
    for name in ("half", "before"):
        shutil.copytree(root / "a", root / name)
    (root / "half" / "run.json").unlink()
    (root / "before" / "item.json").unlink()
    names = ["a", "Grube Süd", "failed", "half", "before", "missing"]
    write_collection(root / "collection.json", root, names, "Night of May 3")
    return root


def links_of(folder):
    catalog = json.loads((folder / "collection.json").read_text(encoding="utf-8"))
    return catalog, [link["href"] for link in catalog["links"] if link["rel"] == "item"]


def test_a_collection_is_valid_and_links_to_complete_maps(night, tmp_path):
    catalog, links = links_of(night)
    assert faults(catalog) == []
    boxes = np.array([item_of(night / name)["bbox"] for name in ("a", "Grube Süd")])
    assert catalog["extent"]["spatial"]["bbox"] == [[*boxes[:, :2].min(axis=0), *boxes[:, 2:].max(axis=0)]]
    assert catalog["extent"]["temporal"]["interval"] == [["2024-05-03T00:00:00Z", "2024-05-03T23:59:59Z"]]
    assert (catalog["license"], [each["name"] for each in catalog["providers"]]) == ("CC-BY-4.0", ["Pits & Co"])
    assert (catalog["id"], catalog["title"]) == ("Night-of-May-3", "Night of May 3")
    assert links == ["./a/item.json", "./Grube Süd/item.json"]
    assert faults({**catalog, "links": [{"rel": "item"}]})
    names = ["100% #2?", "b\udce9", "c\x1b[31m\u202e"]  # which a link cannot hold, or would show as something else
    for name in names:
        shutil.copytree(night / "a", tmp_path / name)
    write_collection(tmp_path / "collection.json", tmp_path, names, names[-1])
    found, links = links_of(tmp_path)
    assert links[:2] == ["./100%25 %232%3F/item.json", "./b%E9/item.json"]
    titles = [found["title"], *(link["title"] for link in found["links"] if link["rel"] == "item")]
    assert titles == [r"c\x1b[31m\u202e", "100% #2?", r"b\xe9", r"c\x1b[31m\u202e"]


def test_pystac_opens_it_and_finds_every_file(night, monkeypatch):
    def refuse(*_):
        raise AssertionError("something asked for the network")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    catalog = pystac.Collection.from_file(str(night / "collection.json"))
    items = list(catalog.get_items(recursive=True))
    assert [item.id for item in items] == ["a", "Grube-S-d"]
    for item in items:
        assert item.get_parent() is item.get_root() is catalog
        for name, asset in item.get_assets().items():
            assert Path(asset.get_absolute_href()).stat().st_size > 0
            assert name in {Path(asset.href).stem, Path(asset.href).name.replace(".", "_")}
        assert item.common_metadata.start_datetime.year in {1970, 2024}
        assert item.common_metadata.license == "CC-BY-4.0"
        said = [(each.name, each.roles) for each in item.common_metadata.providers]
        assert said == [("Pits & Co", ["producer", "licensor"])]
        assert faults(item.to_dict(transform_hrefs=False)) == []


PROPERTIES = {
    *("name", "vehicle", "length_m", "straight_m", "detour", "cost_m", "c_r_mean", "c_r_mean_low", "c_r_mean_high"),
    *("c_r_max", "c_r_max_low", "c_r_max_high", "c_r_line", "c_r_line_low", "c_r_line_high"),
    *("p_arrives", "p_arrives_note", "p_fail_max", "unknown_m", "why"),
    *("obstacle_m", "tight_turns_deg", "climb_m", "descent_m", "seconds", "risk_m"),
    *("points_per_m2", "smallest_object_m", "smallest_step_m", "seen"),
}


def written(route, path):
    write_route_geojson(route, path)
    text = path.read_text(encoding="utf-8")
    collection = json.loads(text, parse_constant=pytest.fail)
    assert collection["type"] == "FeatureCollection"
    assert ("crs" in collection) == ("local_coordinates" in collection)  # RFC 7946, 4, knows no other than WGS 84
    return collection


def lines_of(collection):
    return [feature for feature in collection["features"] if "LineString" in feature["geometry"]["type"]]


@pytest.mark.parametrize(
    ("epsg", "unit", "middle"),
    [
        (32614, 1.0, (480_000.0, 2_136_000.0)),
        (2271, 1200 / 3937, (792_481.585, 76_200.152)),
        (2193, 1.0, (1_590_000.0, 5_190_000.0)),  # northing first
    ],
)
def test_a_line_lies_where_the_way_is(epsg, unit, middle, tmp_path):
    corners = np.array([[0.0, 0.0], [2_500.0, 700.0], [2_600.0, -900.0]]) + middle
    route = make_route(corners=corners, georeference=Georeference(CRS.from_epsg(epsg), unit))
    collection = written(route, tmp_path / "route.geojson")
    (line,) = lines_of(collection)
    lonlat = np.array(line["geometry"]["coordinates"])
    assert np.array_equal(np.round(lonlat, 7), lonlat)
    back = Transformer.from_crs(CRS.from_epsg(4326), CRS.from_epsg(epsg), always_xy=True)
    way = shapely.linestrings(corners)
    for places in (lonlat, (lonlat[:-1] + lonlat[1:]) / 2):  # RFC 7946: straight in degrees between two positions
        ground = np.column_stack(back.transform(*places.T)) * unit
        assert shapely.distance(shapely.points(ground), way).max() < 0.015
    ends = np.column_stack(back.transform(*lonlat[[0, -1]].T)) * unit
    np.testing.assert_allclose(ends, corners[[0, -1]], atol=0.015)
    assert collection["bbox"] == pytest.approx([*lonlat.min(axis=0), *lonlat.max(axis=0)])


def test_figures_are_those_of_the_route_and_what_is_unknown_is_null(tmp_path):
    route = replace(make_route(), figures=replace(FIGURES, c_r_mean=float("nan"), p_fail_max=float("nan")))
    (line,) = lines_of(written(route, tmp_path / "route.geojson"))
    properties = line["properties"]
    assert set(properties) == PROPERTIES
    assert (properties["c_r_mean"], properties["p_fail_max"]) == (None, None)
    assert properties["p_arrives"] == pytest.approx(np.exp(-0.05 - 0.125) * 0.5**FIGURES.obstacle_m, abs=1e-6)
    assert properties["detour"] == pytest.approx(261.135 / 241.868, abs=1e-6)
    assert (properties["vehicle"], properties["risk_m"], properties["climb_m"]) == ("warthog", 25.0, 4.5)
    assert "estimate" in properties["p_arrives_note"]
    assert (properties["smallest_object_m"], properties["seen"]) == (None, "")


def test_a_chance_to_arrive_stands_with_what_would_not_have_been_seen(tmp_path):
    route = replace(make_route(), figures=replace(FIGURES, hazard=0.0, obstacle_m=0.0, seen=SeenSizes(10.0, 0.69, 0.3)))
    route = replace(route, figures=replace(route.figures, tight_turns_deg=0.0))
    write_gpx(route, tmp_path / "route.gpx")
    (line,) = lines_of(written(route, tmp_path / "route.geojson"))
    text = (tmp_path / "route.gpx").read_text()
    assert "arrives over 99.9% if nothing narrower than 0.7 m stands in the way" in text
    assert "if nothing narrower than 0.7 m" in line["properties"]["p_arrives_note"]
    for said in (text, line["properties"]["seen"]):
        assert "objects narrower than 0.7 m and steps lower than 0.3 m are not seen" in said
    assert "arrives over 99.9% if nothing narrower than 0.7 m" in repr(route)


def test_stops_have_roles(tmp_path):
    found = written(make_route(stops=CORNERS), tmp_path / "route.geojson")["features"]
    assert [feature["properties"] for feature in found if feature["geometry"]["type"] == "Point"] == [
        {"role": "start", "name": "start"},
        {"role": "via", "name": "via 1"},
        {"role": "goal", "name": "goal"},
    ]


def test_without_a_crs_files_say_what_their_coordinates_are_and_gpx_is_refused(tmp_path):
    route = make_route(georeference=Georeference(None, 0.5))
    collection = written(route, tmp_path / "route.geojson")
    (line,) = lines_of(collection)
    np.testing.assert_allclose(line["geometry"]["coordinates"], CORNERS / 0.5, atol=1e-3)
    assert "not longitude and latitude" in collection["local_coordinates"]
    assert collection["metres_per_unit"] == 0.5
    write_profile(route, tmp_path / "profile.csv")
    table = pd.read_csv(tmp_path / "profile.csv")
    assert table[["lon", "lat"]].isna().all(axis=None)
    assert table["x"].notna().all()
    with pytest.raises(BadInputError, match="no CRS"):
        write_gpx(route, tmp_path / "route.gpx")
    assert not (tmp_path / "route.gpx").exists()


NAMESPACE = "{http://www.topografix.com/GPX/1/1}"
ORDER = {
    # element: its children in the order of the schema
    "gpx": ("metadata", "wpt", "rte", "trk", "extensions"),
    "metadata": ("name", "desc", "author", "copyright", "link", "time", "keywords", "bounds", "extensions"),
    "trk": ("name", "cmt", "desc", "src", "link", "number", "type", "extensions", "trkseg"),
    "trkseg": ("trkpt", "extensions"),
    "wpt": ("ele", "time", "magvar", "geoidheight", "name", "cmt", "desc", "src", "link", "sym", "type", "fix"),
}
ORDER["trkpt"] = ORDER["wpt"]


def checked(path):
    """Parse a file and hold every element against the schema's order."""
    root = ET.parse(path).getroot()  # noqa: S314 (our own file)
    assert root.tag == f"{NAMESPACE}gpx"
    assert (root.get("version"), bool(root.get("creator"))) == ("1.1", True)
    for element in root.iter():
        name = element.tag.removeprefix(NAMESPACE)
        children = [child.tag.removeprefix(NAMESPACE) for child in element]
        places = [ORDER[name].index(child) for child in children] if children else []
        assert places == sorted(places)
        if name in {"wpt", "trkpt"}:
            assert -180.0 <= float(element.get("lon")) < 180.0
            assert -90.0 <= float(element.get("lat")) <= 90.0
    return root


def test_gdal_reads_the_track_where_the_way_is(tmp_path):
    route = make_route(stops=CORNERS)
    write_gpx(route, tmp_path / "route.gpx")
    checked(tmp_path / "route.gpx")
    _, _, geometry, columns = read(tmp_path / "route.gpx", layer="tracks", columns=["name"])
    assert columns[0].tolist() == ["route"]
    to_grid = Transformer.from_crs(CRS.from_epsg(4326), UTM.crs, always_xy=True)
    line = shapely.from_wkb(geometry)[0].geoms[0]
    ground = np.column_stack(to_grid.transform(*shapely.get_coordinates(line).T))
    assert shapely.hausdorff_distance(shapely.linestrings(ground), shapely.linestrings(CORNERS)) < 0.015
    _, _, waypoints, columns = read(tmp_path / "route.gpx", layer="waypoints", columns=["name"])
    assert columns[0].tolist() == ["start", "via 1", "goal"]
    stops = shapely.get_coordinates(shapely.from_wkb(waypoints))
    np.testing.assert_allclose(np.column_stack(to_grid.transform(*stops.T)), CORNERS, atol=0.015)
    _, _, _, heights = read(tmp_path / "route.gpx", layer="track_points", columns=["ele"])
    expected = track_points(route)[:, 2]
    np.testing.assert_allclose(heights[0][: len(expected)], expected, atol=6e-4)
    assert np.isnan(expected).any()


def test_characters_that_xml_cannot_hold_are_replaced(tmp_path):
    write_gpx(make_route("a\x00b\ud800 <&> é"), tmp_path / "route.gpx")
    assert checked(tmp_path / "route.gpx").findtext(f"{NAMESPACE}trk/{NAMESPACE}name") == "a?b? <&> é"


@pytest.mark.parametrize("georeference", [UTM, Georeference(CRS.from_epsg(32614), 0.5)])
def test_every_number_of_the_profile_is_there(georeference, tmp_path):
    route = make_route(georeference=georeference)
    write_profile(route, tmp_path / "profile.csv")
    found, profile = pd.read_csv(tmp_path / "profile.csv"), route.profile
    assert tuple(found.columns) == PROFILE_COLUMNS
    places = np.column_stack([profile.easting, profile.northing]) / georeference.metres_per_unit
    metres = {"distance_m": profile.distance, "x": places[:, 0], "y": places[:, 1], "z_m": profile.z}
    metres |= {"slope_deg": profile.slope, "cost_m": profile.cost, "obstacle": profile.obstacle}
    for name, values in metres.items():
        np.testing.assert_allclose(found[name], values, atol=6e-4, err_msg=name)
    for name in ("c_r", "c_r_low", "c_r_high", "p_fail"):
        np.testing.assert_allclose(found[name], getattr(profile, name), atol=6e-7, err_msg=name)
    assert found["c_r"].isna().any()
    back = Transformer.from_crs(CRS.from_epsg(4326), georeference.crs, always_xy=True)
    np.testing.assert_allclose(np.column_stack(back.transform(found["lon"], found["lat"])), places, atol=0.015)


def stretches_in(result, path, georeference=UTM):
    """The file, and the positions in it."""
    ground = replace(MadeUpMap.around(), georeference=georeference)
    write_stretches(result, place_stretches(result.stretches, ground), path)
    found = json.loads(path.read_text())
    return found, np.array([feature["geometry"]["coordinates"] for feature in found["features"]])


@pytest.mark.parametrize(
    ("georeference", "shift"),
    [
        (UTM, (0.0, 0.0)),
        (Georeference(CRS.from_epsg(2277), 1200 / 3937), (600_000.0, 1_000_000.0)),
        (Georeference(None, 0.3048), (0.0, 0.0)),
    ],
)
def test_stretches_lie_where_they_were_driven(tmp_path, georeference, shift):
    """Positions of stretches are metres on the grid, files hold the units of the CRS."""
    made = made_up_check().stretches
    driven = replace(made, easting=made.easting + shift[0], northing=made.northing + shift[1])
    found, places = stretches_in(replace(made_up_check(), stretches=driven), tmp_path / "check.geojson", georeference)
    assert ("local_coordinates" in found) == (georeference.crs is None)
    assert found["bbox"] == [*places.min(axis=0), *places.max(axis=0)]
    if georeference.crs is not None:
        back = Transformer.from_crs("OGC:CRS84", georeference.crs, always_xy=True)
        places = np.column_stack(back.transform(*places.T))
    x, y = places.T * georeference.metres_per_unit
    assert np.hypot(x - driven.easting, y - driven.northing).max() < 0.02


def test_stretches_say_what_was_measured_and_what_the_map_says(tmp_path):
    result = made_up_check(unknown=[2])
    found, _ = stretches_in(result, tmp_path / "check.geojson")
    assert [feature["id"] for feature in found["features"]] == list(range(1, 41))
    about, stretches = found["features"][0]["properties"], result.stretches
    assert about["measured"] == pytest.approx(stretches.measured[0], abs=1e-6)
    assert about["c_r_line"] == pytest.approx(result.by_line.c_r[0], abs=1e-6)
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
    found, _ = stretches_in(result, tmp_path / "check.geojson")
    assert [feature["id"] for feature in found["features"]] == [*range(1, 6), *range(9, 41)]


ONE = np.array([[330_000.0, 2_040_000.0]])


def offset_of(factor, **changes):
    return MapOffset.of(replace(stretches_at(ONE, [0.1], np.array([factor])), **changes))


def test_the_kind_is_named_from_the_map():
    named = {
        1.19: "map within a factor of 1.2",
        1.0: "map within a factor of 1.2",
        1 / 1.19: "map within a factor of 1.2",
    }
    for factor, kind in ((2.01, "over 2 times"), (1.99, "1.5 to 2 times"), (1.49, "1.2 to 1.5 times")):
        named |= {factor: f"map {kind} too low", 1 / factor: f"map {kind} too high"}
    for factor, kind in named.items():
        offset = offset_of(factor)
        assert offset.ratio == pytest.approx(1 / factor)
        assert OFF_KINDS[int(offset.kind[0])] == kind


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


# ---- scans ----


def test_points_say_whether_they_are_ground_how_high_and_in_the_colour_of_that(scan, classed, tmp_path):
    rng = np.random.default_rng(7)
    height = np.where(rng.uniform(size=len(scan.points)) < 0.2, np.nan, rng.uniform(0, 3, len(scan.points)))
    stack = replace(classed.sectors, point_height=height.astype(np.float32), point_ground=height < 0.1)
    write_cloud(replace(scan, label=None), replace(classed, sectors=stack), tmp_path / "b.ply")
    assert "label" not in read_vertices(tmp_path / "b.ply").dtype.names
    write_cloud(scan, replace(classed, sectors=stack), tmp_path / "a.ply")
    vertex = read_vertices(tmp_path / "a.ply")
    np.testing.assert_array_equal(np.stack([vertex[axis] for axis in "xyz"], axis=1), scan.points)
    own = {"class": classed.point_class, "intensity": scan.intensity, "label": scan.label}
    for name, values in (own | {"height": stack.point_height, "ground": stack.point_ground}).items():
        np.testing.assert_array_equal(vertex[name], values)
    colours = np.stack([vertex[name] for name in ("red", "green", "blue")], axis=1)
    class_id = vertex["class"].astype(int)
    is_ground, stands = height < 0.1, (height >= 0.25) & (height <= 1.38) & ~stack.point_airborne
    for style, chosen in enumerate(
        [*(is_ground & (class_id == own) for own in range(3)), stands, ~stands & (~is_ground | (class_id == 255))]
    ):
        assert chosen.any()
        assert (colours[chosen] == SCAN_COLOURS[style]).all()
    assert len(np.unique(SCAN_COLOURS, axis=0)) == 5


def rows_of(path, *frames):
    with open_table(path) as add_rows:
        for name, classed in frames:
            add_rows(sector_rows(name, classed))
    return pq.read_table(path)


FRAME_NAMES = [f"{stem}.{kind}" for stem in ("f0", "f1", "A", "a", "000001_a", "000002_a") for kind in ("ply", "bin")]


@settings(max_examples=40)
@given(st.lists(st.sampled_from(FRAME_NAMES), min_size=1, max_size=8))
def test_no_two_frames_have_one_name_on_any_disk(names):
    paths = [Path(f"run{number}") / name for number, name in enumerate(names)]
    frames = name_frames([Frame(path) for path in paths])
    assert len({frame.name.casefold() for frame in frames}) == len(paths)
    assert [frame.path for frame in frames] == paths
    stems = [path.stem for path in paths]
    if len({stem.casefold() for stem in stems}) == len(stems):
        assert [frame.name for frame in frames] == stems
    else:
        assert all(frame.name.endswith(f"_{stem}") for frame, stem in zip(frames, stems, strict=True))
        assert sorted(frame.name for frame in frames) == [frame.name for frame in frames]


def test_rows_are_the_sectors_of_all_frames_in_order(classed, nothing, tmp_path):
    found = rows_of(tmp_path / "a.parquet", ("one", classed), ("empty", nothing[1]), ("two", classed))
    stack, count = classed.sectors, len(classed.class_id)
    assert found.column_names == [name for name, *_ in COLUMNS]
    assert found["frame"].to_pylist() == ["one"] * count + ["two"] * count
    same = ("zone", "ring", "sector", "traversable", "obstacle", "obstacle_height", "clearance")
    expected = {name: getattr(stack, name) for name in (*same, "variance", "residual", "coverage", "label")}
    expected |= {f"normal_{axis}": stack.normal[:, number] for number, axis in enumerate("xyz")}
    bounds = sector_bounds(stack)
    expected |= {name: getattr(bounds, name).astype(np.float32) for name in ("near", "far", "right", "left")}
    expected |= {"points": stack.count, "ground_points": stack.ground_count, "stripes": classed.stripes}
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name].to_numpy(), np.concatenate([values, values]), err_msg=name)
    class_id = [None if value == 255 else value for value in classed.class_id.tolist()]
    assert found["class"].to_pylist() == class_id + class_id
    assert [value is None for value in class_id] == (~stack.traversable).tolist()


def fill(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("x")


@pytest.mark.parametrize(
    ("files", "overwrite", "words"),
    [
        *([[name], False, r"already holds .*`overwrite=True`"] for name in ("sectors.parquet", "map/run.json")),
        (["scan.json", "frames/a.png"], False, r"already holds .*`overwrite=True`"),
        (["frames/a.png"], True, "frames was not written by a complete scan run"),
        (["scan.json", "frames/notes.txt"], True, r"notes\.txt was not written by a complete scan run"),
        *([[name], True, "so it cannot be replaced"] for name in ("frames", "scan.json/a")),
    ],
)
def test_a_folder_that_holds_something_else_or_an_earlier_run_is_refused(tmp_path, files, overwrite, words):
    fill(tmp_path, *files)
    with pytest.raises(OutputError, match=words):
        check_scan_folder(tmp_path, overwrite=overwrite)
    assert sorted(files_in(tmp_path)) == sorted(files)
    if not overwrite:
        fill(tmp_path, "scan.json")
        check_scan_folder(tmp_path, overwrite=True)


@pytest.mark.parametrize("ended", [True, False])
def test_the_scans_that_are_read_are_not_replaced(tmp_path, ended):
    fill(tmp_path, "drive/frames/0.ply", *(["drive/scan.json"] if ended else []))
    (tmp_path / "link").symlink_to(tmp_path / "drive")
    with pytest.raises(OutputError, match="is an input of this run"):
        check_scan_folder(tmp_path / "drive", [tmp_path / "link" / "frames" / "0.ply"], overwrite=True)
    check_scan_folder(tmp_path / "out", [tmp_path / "link" / "frames" / "0.ply"], overwrite=True)


def test_older_products_go_and_everything_else_stays(tmp_path):
    fill(tmp_path, "out/frames/a.png", "out/gathered.laz", "out/scan.json", "out/notes.txt", "out/map/my_style.qml")
    fill(tmp_path, "out/map/run.json", "out/map/rasters/class.tif", "out/map/rasters/class.tif.aux.xml")
    fill(tmp_path, "new/sectors.parquet", "new/scan.json")
    assert move_products(tmp_path / "new", tmp_path / "out") == ("sectors.parquet", "scan.json")
    assert sorted(files_in(tmp_path / "out")) == ["map/my_style.qml", "notes.txt", "scan.json", "sectors.parquet"]
    assert not (tmp_path / "out" / "frames").exists()
    (tmp_path / "out" / "map" / "my_style.qml").unlink()
    fill(tmp_path, "out/map/run.json", "newer/scan.json")
    move_products(tmp_path / "newer", tmp_path / "out")
    assert not (tmp_path / "out" / "map").exists()


@pytest.mark.parametrize("crs", [CRS.from_epsg(32614), None])
def test_points_are_written_where_they_are_with_their_classes(tmp_path, crs):
    rng = np.random.default_rng(1)
    offset = np.array([500_000.0, 4_000_000.0, 321.0])
    world, ground = offset + rng.uniform(-80.0, 80.0, (500, 3)), rng.uniform(size=500) < 0.5
    for name in ("a.laz", "b.laz"):
        with open_accumulated(tmp_path / name, offset, crs) as add_points:
            for part in (slice(200), slice(0), slice(200, None)):
                add_points(world[part], ground[part])
    assert (tmp_path / "a.laz").read_bytes() == (tmp_path / "b.laz").read_bytes()
    las = laspy.read(tmp_path / "a.laz")
    assert las.header.parse_crs() == crs
    np.testing.assert_allclose(las.xyz, world, atol=0.00051)
    np.testing.assert_array_equal(las.classification, np.where(ground, 2, 1))
    np.testing.assert_allclose(las.header.mins, world.min(axis=0), atol=0.00051)
