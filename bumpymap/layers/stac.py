"""Write item.json: a map as a STAC item."""

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import shapely
from pyproj import CRS

from bumpymap.core import BadInputError, atomic, escape_controls, read_record, stated_crs
from bumpymap.layers.map_reader import open_layer
from bumpymap.layers.placement import Placement
from bumpymap.layers.products import COLLECTION_NAME, EVERY_NAME, EVERY_VIEW_NAME, MapFile
from bumpymap.layers.vector import GeoJsonCoordinates

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

_SHA256 = "1220"
"""First bytes of a multihash: the code of SHA-256 and the length of its digest, 32 bytes."""
_COG = "image/tiff; application=geotiff; profile=cloud-optimized"
_TYPES = {
    ".tif": _COG,
    ".parquet": "application/vnd.apache.parquet",
    ".geojson": "application/geo+json",
    ".fgb": "application/vnd.flatgeobuf",
    ".json": "application/json",
    ".html": "text/html",
    ".qgs": "application/x-qgis-project",
    ".qml": "application/x-qgis-layer-settings",
    ".xml": "application/xml",
    ".jpg": "image/jpeg",
}
_TITLES = {
    MapFile.TILES: "all values of each tile",
    MapFile.REGIONS: "regions of one class, with their cost",
    MapFile.REGIONS_IN_CRS: "regions of one class, with their cost, in the CRS of the survey",
    MapFile.MANIFEST: "inputs, settings, versions and checksums of the run",
    MapFile.REPORT: "the map as a page",
    MapFile.PROJECT: "all layers as a project of QGIS",
    MapFile.THUMBNAIL: "the classes over the relief",
    ".qml": "style of the layer, for QGIS",
    ".xml": "names of the values, for GDAL",
}
_ROLES = {".html": "overview", ".qgs": "overview", ".jpg": "thumbnail"}
_WITH_HEIGHTS = (MapFile.HEIGHTMAP, MapFile.RELIEF, MapFile.TILES)
"""Files in the survey's CRS with its vertical part."""


def describe_assets(folder: Path, record: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the assets of an item: every file of a map; rasters, with their grid and bands, by their stems.

    The others have an underscore for each dot: odc-stac takes what follows one for the number of a band. Files to look
    at the others with are assets if they are there; they have no size and no checksum, since GIS programs rewrite them.
    ``record`` is the content of run.json.
    """
    known = {file["path"]: file for file in record["files"]}
    crs = None if record["crs"] is None else stated_crs(record["crs"]["wkt"])
    vertical = describe_crs(crs) if crs is not None and crs.is_compound else {}
    assets = {}
    layers = [name for name in EVERY_NAME if name in known and name != MapFile.ITEM]
    views = [*EVERY_VIEW_NAME, *(f"{name}.aux.xml" for name in layers)]
    for name in (*layers, MapFile.MANIFEST, *(name for name in views if (folder / name).is_file())):
        role = "data" if name in known else _ROLES.get(Path(name).suffix, "metadata")
        asset = {"href": f"./{name}", "type": _TYPES[Path(name).suffix], "roles": [role]}
        if name.endswith(".tif"):
            asset |= _raster(folder / name, record)
        title = _TITLES.get(name) or _TITLES.get(Path(name).suffix)
        asset |= {"title": title} if title else {}
        asset |= vertical if name in _WITH_HEIGHTS else {}
        if name in known:
            asset |= {"file:size": known[name]["bytes"], "file:checksum": f"{_SHA256}{known[name]['sha256']}"}
        path = Path(name)
        assets[path.stem if path.suffix in {".tif", ".jpg"} else path.name.replace(".", "_")] = asset
    return assets


def describe_crs(crs: CRS | None) -> dict[str, Any]:
    """Return the fields of a CRS: its code, or null and its WKT."""
    if crs is None:
        return {"proj:code": None}
    authority = crs.to_authority()
    return {"proj:code": None, "proj:wkt2": crs.to_wkt()} if authority is None else {"proj:code": ":".join(authority)}


def _grid_of(raster: "DatasetReader") -> dict[str, Any]:
    """Return the fields of the grid of pixels of a raster: shape, transform and bounds in units of its CRS."""
    return {
        "proj:shape": list(raster.shape),
        "proj:transform": list(raster.transform)[:6],
        "proj:bbox": list(raster.bounds),
    }


def _raster(path: Path, record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a raster: its title, the size of its pixels and their grid, its bands.

    odc-stac finds bands by the names in ``eo:bands``, other programs by those in ``bands``.
    """
    with open_layer(path) as raster:
        title, pixel = raster.tags().get("title"), raster.transform.a * record["metres_per_unit"]["horizontal"]
        bands = [
            {"name": name, "description": raster.tags(number).get("long_name", name)} | ({"unit": unit} if unit else {})
            for number, (name, unit) in enumerate(zip(raster.descriptions, raster.units, strict=True), 1)
        ]
        empty = {} if raster.nodata is None else {"nodata": "nan" if math.isnan(raster.nodata) else int(raster.nodata)}
        values = {
            "data_type": raster.dtypes[0],
            **empty,
            "bands": bands,
            "eo:bands": [{"name": band["name"]} for band in bands],
        }
        return ({"title": title} if title else {}) | {"gsd": round(pixel, 9), **_grid_of(raster), **values}


STAC_VERSION = "1.1.0"


def identifier(name: str) -> str:
    """Return a name with only letters of ASCII, digits, dots, ``-`` and ``_``, as STAC wants of an id.

    Of a name that has none of these the id is made from its checksum.
    """
    text = re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.")
    return text or f"survey-{hashlib.sha256(name.encode('utf-8', 'surrogateescape')).hexdigest()[:8]}"


def write_document(document: Mapping[str, Any], path: Path) -> None:
    """Write JSON; lists of numbers stand in one line. Raises OutputError if the file cannot be written."""
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    text = re.sub(
        r"\[\n\s*([-+.\de]+(?:,\n\s*[-+.\de]+)*)\n\s*\]",
        lambda found: f"[{', '.join(found[1].replace(',', ' ').split())}]",
        text,
    )
    with atomic(path) as temporary:
        temporary.write_text(f"{text}\n", encoding="utf-8")


_ESCAPED = re.compile("[#?%\\x00-\\x1f\ud800-\udfff]")
"""Characters that a link cannot hold: surrogates stand for bytes of a file name that are not UTF-8."""


def write_collection(path: Path, root: Path, folders: Sequence[str], title: str) -> None:
    """Write a STAC collection with a link to the item of each complete map.

    Its licence is the one that all of them state, else ``other``. Items do not link back: they are the same whether a
    map was made alone or with others. ``root``: the folder that holds those of the maps; links start there;
    ``folders``: their names in it, in the order of the links. One without a complete map is left out. ``title``: of the
    catalogue. Raises OutputError: the file cannot be written.
    """
    found = {each: read_record(root / each / MapFile.ITEM) for each in folders}
    items = {each: item for each, item in found.items() if item and (root / each / MapFile.MANIFEST).is_file()}
    # pystac opens links as they are written: only what would end or change one is escaped.
    quoted = {each: _ESCAPED.sub(lambda one: quote(one[0], safe="", errors="surrogateescape"), each) for each in items}
    links = [_link("item", f"./{quoted[each]}/{MapFile.ITEM}", each) for each in items]
    name, properties = escape_controls(title), [item["properties"] for item in items.values()]
    licences = {about.get("license", "other") for about in properties}
    providers = {provider["name"]: provider for about in properties for provider in about.get("providers", ())}
    document = {
        "type": "Collection",
        "stac_version": STAC_VERSION,
        "id": identifier(name),
        "title": name,
        "description": "Roughness and ride cost of the ground, from point clouds: one item for each survey",
        "license": licences.pop() if len(licences) == 1 else "other",
        **({"providers": list(providers.values())} if providers else {}),
        "extent": _extent(list(items.values())),
        "links": [_link("root", f"./{COLLECTION_NAME}", title) | {"type": "application/json"}, *links],
    }
    write_document(document, path)


def _extent(items: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the box and the days of items: the whole Earth without a place, any time if no dates are known."""
    boxes = [item["bbox"] for item in items if "bbox" in item] or [[-180.0, -90.0, 180.0, 90.0]]
    bbox = [pick(side) for pick, side in zip((min, min, max, max), zip(*boxes, strict=True), strict=True)]
    dated = [item["properties"] for item in items if item["properties"]["bumpymap:dates_known"]]
    first = min((about["start_datetime"] for about in dated), default=_ANY_INTERVAL[0])
    last = max((about["end_datetime"] for about in dated), default=_ANY_INTERVAL[1])
    return {"spatial": {"bbox": [bbox]}, "temporal": {"interval": [[first, last]]}}


def _link(rel: str, href: str, title: str) -> dict[str, Any]:
    return {"rel": rel, "href": href, "type": "application/geo+json", "title": escape_controls(title)}


_EXTENSIONS = ("projection/v2.0.0", "file/v2.1.0", "processing/v1.1.0", "eo/v1.1.0")
_SCHEMA = "https://stac-extensions.github.io/{}/schema.json"
_DIGITS = 8
"""Of the checksum of a survey in an id: chosen."""
_ANY_INTERVAL = ("1970-01-01T00:00:00Z", "2099-12-31T23:59:59Z")
"""Dates of a survey whose files have none: STAC wants an interval, and a search for any date shall find it."""
_SOFTWARE = {"bumpymap": "bumpymap", "gdal": "GDAL", "proj": "PROJ"}


def write_item(folder: Path, record: Mapping[str, Any], place: Placement) -> None:
    """Write item.json to a folder of complete layers: a STAC item with every file as an asset.

    It follows from the layers and the survey alone: no time, and no place of the folder is in it. ``record``: the
    content of run.json, which need not be there yet. Raises OutputError: the file cannot be written.
    """
    name = escape_controls(record["survey"]["name"])
    calibration = record["calibration"]
    about = f"Roughness and ride cost of the ground for the vehicle {calibration['vehicle']}"
    own = {  # properties that no extension has
        "vehicle": calibration["vehicle"],
        "calibration": calibration["id"],
        "class_limits": calibration["class_limits"],
        "texture_model": record["model"],
        "survey_checksum": record["survey"]["checksum"],
        "counts": {key: record["counts"][key] for key in ("tiles", "classified", "passable", "by_class")},
    }
    # What tells surveys of one name apart.
    digits = (record["survey"]["checksum"] or "").rpartition(":")[2][:_DIGITS]
    with open_layer(folder / MapFile.CLASS) as raster:  # one pixel for each tile
        grid = _grid_of(raster)
    item = {
        "type": "Feature",
        "stac_version": STAC_VERSION,
        "stac_extensions": [_SCHEMA.format(extension) for extension in _EXTENSIONS],
        "id": "_".join([identifier(name), *([digits] if digits else [])]),
        **_footprint(place),
        "properties": {
            "title": name,
            "description": f"{about}, from a point cloud, in tiles of {place.grid.tile_size:g} m",
            **_interval(record),
            **_rights(record),
            "gsd": place.grid.tile_size,
            **describe_crs(place.horizontal_crs),
            **grid,
            "processing:software": {
                name: record["versions"][key] for key, name in _SOFTWARE.items() if key in record["versions"]
            },
            **{f"bumpymap:{key}": value for key, value in own.items() if value is not None},
        },
        "links": [],
        "assets": describe_assets(folder, record),
    }
    write_document(item, folder / MapFile.ITEM)


def _interval(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the days of the survey as STAC states an interval; the widest if the files have no dates."""
    try:
        days = sorted(date.fromisoformat(day).isoformat() for day in record["survey"]["dates"] or ())
        first, last = (f"{day}T{time}Z" for day, time in zip(days, ("00:00:00", "23:59:59"), strict=True))
        known = True
    except (TypeError, ValueError):
        (first, last), known = _ANY_INTERVAL, False
    return {"datetime": None, "start_datetime": first, "end_datetime": last, "bumpymap:dates_known": known}


def _rights(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return who made the survey (provider, or operator of the page) and the licence of the layers, if stated."""
    provider, licence = (str(record["settings"].get(name) or "") for name in ("provider", "license"))
    provider = provider or str((record.get("page") or {}).get("operator") or "")
    found: dict[str, Any] = {"license": licence} if licence else {}
    return found | ({"providers": [{"name": provider, "roles": ["producer", "licensor"]}]} if provider else {})


def _footprint(place: Placement) -> dict[str, Any]:
    """Return the outline of the raster and its box, longitude and latitude; no place on Earth is null."""
    try:
        coordinates, window = GeoJsonCoordinates.of(place, local=False), place.window
        corners = (window.col, window.row, window.col + window.cols, window.row + window.rows)
        outlines = coordinates.polygons(shapely.polygons([shapely.box(*corners).exterior]))
    except BadInputError:
        return {"geometry": None}
    return {"bbox": shapely.total_bounds(outlines).tolist(), "geometry": shapely.geometry.mapping(outlines[0])}
