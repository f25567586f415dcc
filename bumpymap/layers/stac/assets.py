"""The files of a map as the assets of its STAC item."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pyproj import CRS

from bumpymap.core import stated_crs
from bumpymap.layers.manifest import MANIFEST_NAME
from bumpymap.layers.map_files import open_layer
from bumpymap.layers.products import EVERY_NAME, EVERY_VIEW_NAME, ITEM_NAME
from bumpymap.layers.stac.classes import classes_of_band

__all__ = ["describe_assets", "describe_crs", "describe_grid"]

_SHA256 = "1220"
"""What a multihash begins with: the code of SHA-256 and the length of its digest, 32 bytes."""
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
}
_TITLES = {
    "tiles.parquet": "all values of each tile",
    "cost.geojson": "regions of one class, with their cost",
    "cost.fgb": "regions of one class, with their cost, in the CRS of the survey",
    "run.json": "inputs, settings, versions and checksums of the run",
    "report.html": "the map as a page",
    "map.qgs": "all layers as a project of QGIS",
    ".qml": "style of the layer, for QGIS",
    ".xml": "names of the values, for GDAL",
}
_OVERVIEWS = (".html", ".qgs")
_WITH_HEIGHTS = ("heightmap.tif", "relief.tif", "tiles.parquet")
"""Files in the survey's CRS with its vertical part."""
_STATISTICS = {
    "STATISTICS_MINIMUM": "minimum",
    "STATISTICS_MAXIMUM": "maximum",
    "STATISTICS_MEAN": "mean",
    "STATISTICS_STDDEV": "stddev",
    "STATISTICS_VALID_PERCENT": "valid_percent",
}


def describe_assets(folder: Path, record: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the assets of an item: every file of a map by its name, with what its header says.

    Files to look at the others with are assets if they are there; they have no size and no checksum, since GIS programs
    rewrite them.

    Parameters
    ----------
    folder : Path
        With the complete layers.
    record : mapping
        The content of run.json.
    """
    known = {file["path"]: file for file in record["files"]}
    crs = None if record["crs"] is None else stated_crs(record["crs"]["wkt"])
    vertical = describe_crs(crs) if crs is not None and crs.is_compound else {}
    assets = {}
    for name in _names(folder, known):
        asset = {"href": f"./{name}", "type": _TYPES[Path(name).suffix], "roles": [_role(name, known)]}
        if name.endswith(".tif"):
            asset |= _raster(folder / name, record)
        elif name.endswith(".parquet"):
            asset |= _table(folder / name)
        title = _TITLES.get(name) or _TITLES.get(Path(name).suffix)
        asset |= {"title": title} if title else {}
        asset |= vertical if name in _WITH_HEIGHTS else {}
        if name in known:
            asset |= {"file:size": known[name]["bytes"], "file:checksum": f"{_SHA256}{known[name]['sha256']}"}
        assets[name] = asset
    return assets


def describe_crs(crs: CRS | None) -> dict[str, Any]:
    """Return the fields of a CRS: its code, or null and its WKT."""
    if crs is None:
        return {"proj:code": None}
    authority = crs.to_authority()
    return {"proj:code": None, "proj:wkt2": crs.to_wkt()} if authority is None else {"proj:code": ":".join(authority)}


def describe_grid(path: Path) -> dict[str, Any]:
    """Return the fields of the grid of pixels of a raster: shape, transform and bounds in units of its CRS."""
    with open_layer(path) as raster:
        return {
            "proj:shape": list(raster.shape),
            "proj:transform": list(raster.transform)[:6],
            "proj:bbox": list(raster.bounds),
        }


def _names(folder: Path, known: Mapping[str, Any]) -> list[str]:
    """Return the names of the files of a folder in a lasting order; run.json will be there."""
    layers = [name for name in EVERY_NAME if name in known and name != ITEM_NAME]
    sides = [f"{name}.aux.xml" for name in layers]
    return [*layers, MANIFEST_NAME, *(name for name in (*EVERY_VIEW_NAME, *sides) if (folder / name).is_file())]


def _role(name: str, known: Mapping[str, Any]) -> str:
    if name in known:
        return "data"
    return "overview" if name.endswith(_OVERVIEWS) else "metadata"


def _raster(path: Path, record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a raster: its bands and its pixels."""
    limits = _class_limits(record)
    with open_layer(path) as raster:
        bands = [_band(raster, number, limits) for number in raster.indexes]
        title, pixel = raster.tags().get("title"), raster.transform.a * record["metres_per_unit"]["horizontal"]
    found: dict[str, Any] = {"title": title} if title else {}
    found |= {"gsd": round(pixel, 9), **describe_grid(path), "bands": bands}
    if len(bands) == 1 and "classification:classes" in bands[0]:  # where programs that know no bands look for them
        found["classification:classes"] = bands[0].pop("classification:classes")
    return found


def _band(raster: Any, number: int, limits: Sequence[float]) -> dict[str, Any]:
    """Return the fields of a band that are known."""
    tags, name, kind = raster.tags(number), raster.descriptions[number - 1] or "", raster.dtypes[number - 1]
    codes = kind == "uint8"  # a share of pixels may have the name of a band of codes
    fields = {
        "name": name,
        "description": tags.get("long_name"),
        "unit": raster.units[number - 1],
        "data_type": kind,
        "nodata": _nodata(raster.nodatavals[number - 1]),
        "statistics": _statistics(tags),
        "classification:classes": classes_of_band(name, limits) if codes else None,
    }
    return {key: value for key, value in fields.items() if value not in (None, "", {})}


def _nodata(value: float | None) -> float | str | None:
    """Return a value as JSON can hold it."""
    if value is None or math.isnan(value):
        return None if value is None else "nan"
    return int(value) if value.is_integer() else value


def _statistics(tags: Mapping[str, str]) -> dict[str, float]:
    """Return the statistics that GDAL wrote to a band."""
    found = {}
    for key, name in _STATISTICS.items():
        with suppress(KeyError, ValueError):
            value = float(tags[key])
            if math.isfinite(value):
                found[name] = value
    return found


def _class_limits(record: Mapping[str, Any]) -> Sequence[float]:
    """Return the ride costs between classes, rad/m; none if the classes were made by a table of textures."""
    calibration = record.get("calibration")
    if record.get("settings", {}).get("rating") != "ride" or not isinstance(calibration, Mapping):
        return ()
    limits: Sequence[float] = calibration.get("class_limits") or ()
    return limits


def _table(path: Path) -> dict[str, Any]:
    """Return the fields of tiles.parquet: its columns and the number of its rows."""
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
    columns = [
        {"name": field.name, "type": str(field.type), "description": (field.metadata or {}).get(b"description", b"")}
        for field in schema
    ]
    for column in columns:
        column["description"] = column["description"].decode()
        if not column["description"]:
            del column["description"]
    return {"table:columns": columns, "table:primary_geometry": "geometry", "table:row_count": rows}
