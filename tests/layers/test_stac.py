"""item.json, and collection.json, a collection: valid by the schemas of STAC, opened by pystac, true to the files."""

import hashlib
import json
import shutil
import socket
from functools import cache
from pathlib import Path

import numpy as np
import pystac
import pytest
import rasterio
import shapely
from cost_maps import make_field, table_of
from jsonschema import Draft7Validator
from PIL import Image
from pyproj import CRS, Transformer
from referencing import Registry, Resource
from referencing.jsonschema import DRAFT7
from route_maps import RUN
from small_surveys import files_in

from bumpymap.core.types import Georeference
from bumpymap.layers import PRODUCT_NAMES, Placement, open_map, write_products
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
