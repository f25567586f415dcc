"""Write item.json: a map as a STAC item."""

from collections.abc import Mapping
from datetime import date
from pathlib import Path, PurePosixPath
from typing import Any

import shapely
from pyproj import CRS

from bumpymap.core import BadInputError, Georeference, stated_crs
from bumpymap.layers.lonlat import BoundingBox, polygons_in_wgs84, wgs84_transformer
from bumpymap.layers.placement import Placement
from bumpymap.layers.products import ITEM_NAME
from bumpymap.layers.stac.assets import describe_assets, describe_crs, describe_grid
from bumpymap.layers.stac.document import STAC_VERSION, identifier, valid_text, write_document
from bumpytiles import Grid, TileWindow

__all__ = ["write_item"]

_EXTENSIONS = ("projection/v2.0.0", "file/v2.1.0", "classification/v2.0.0", "processing/v1.1.0", "table/v1.2.0")
_SCHEMA = "https://stac-extensions.github.io/{}/schema.json"
_TILES = "class.tif"
"""A raster with one pixel for each tile."""
_DIGITS = 8
"""Of the checksum of a survey in an id."""
_ANY_TIME = ("1970-01-01", "2099-12-31")
"""Dates of a survey whose files have none: STAC wants an interval, and a search for any date shall find it."""
_SOFTWARE = {"bumpymap": "bumpymap", "gdal": "GDAL", "proj": "PROJ"}


def write_item(folder: Path, record: Mapping[str, Any]) -> None:
    """Write item.json to a folder of complete layers: a STAC item with every file as an asset.

    It follows from the layers and the survey alone: no time, and no place of the folder is in it.

    Parameters
    ----------
    folder : Path
    record : mapping
        The content of run.json, which need not be there yet.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    name = valid_text(_survey_name(record))
    grid = describe_grid(folder / _TILES)
    crs = None if record["crs"] is None else stated_crs(record["crs"]["wkt"])
    place = _placement(record, grid, crs)
    item = {
        "type": "Feature",
        "stac_version": STAC_VERSION,
        "stac_extensions": [_SCHEMA.format(extension) for extension in _EXTENSIONS],
        "id": _identity(name, record),
        **_footprint(place),
        "properties": {
            "title": name,
            "description": _description(record),
            **_interval(record),
            "gsd": place.grid.tile_size,
            **describe_crs(place.horizontal_crs),
            **grid,
            "processing:software": {
                name: record["versions"][key] for key, name in _SOFTWARE.items() if key in record["versions"]
            },
            **_own(record),
        },
        "links": [],
        "assets": describe_assets(folder, record),
    }
    write_document(item, folder / ITEM_NAME)


def _identity(name: str, record: Mapping[str, Any]) -> str:
    """Return the id: the name, what tells surveys of one name apart, and the place of a sheet."""
    sheet = record.get("sheet") or {}
    digits = str(_survey(record).get("checksum") or "").rpartition(":")[2][:_DIGITS]
    place = [f"column{sheet['column']}", f"row{sheet['row']}"] if sheet else []
    return "_".join([identifier(name), *([digits] if digits else []), *place])


def _survey_name(record: Mapping[str, Any]) -> str:
    if name := _survey(record).get("name"):
        return str(name)
    return min((PurePosixPath(str(file["path"])).stem for file in record.get("inputs") or ()), default="map")


def _description(record: Mapping[str, Any]) -> str:
    vehicle, tile = _calibration(record).get("vehicle"), record["grid"]["tile_size_m"]
    whose = f" for the vehicle {vehicle}" if vehicle else ""
    return f"Roughness and ride cost of the ground{whose}, from a point cloud, in tiles of {tile:g} m"


def _interval(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the days of the survey as STAC states an interval; the widest if the files have no dates."""
    try:
        first, last = sorted(date.fromisoformat(day).isoformat() for day in _survey(record).get("dates") or ())
        known = True
    except (TypeError, ValueError):
        (first, last), known = _ANY_TIME, False
    return {
        "datetime": None,
        "start_datetime": f"{first}T00:00:00Z",
        "end_datetime": f"{last}T23:59:59Z",
        "bumpymap:dates_known": known,
    }


def _own(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the properties that no extension has."""
    calibration = _calibration(record)
    fields = {
        "vehicle": calibration.get("vehicle"),
        "calibration": calibration.get("id"),
        "class_limits": calibration.get("class_limits"),
        "texture_model": record.get("model"),
        "survey_checksum": _survey(record).get("checksum"),
        "counts": {key: record["counts"][key] for key in ("tiles", "classified", "passable", "by_class")},
    }
    return {f"bumpymap:{key}": value for key, value in fields.items() if value is not None}


def _survey(record: Mapping[str, Any]) -> Mapping[str, Any]:
    survey = record.get("survey")
    return survey if isinstance(survey, Mapping) else {}


def _calibration(record: Mapping[str, Any]) -> Mapping[str, Any]:
    calibration = record.get("calibration")
    return calibration if isinstance(calibration, Mapping) else {"id": calibration}


def _placement(record: Mapping[str, Any], grid: Mapping[str, Any], crs: CRS | None) -> Placement:
    """Return the raster of the tiles, from its shape and transform."""
    unit, tile = record["metres_per_unit"]["horizontal"], record["grid"]["tile_size_m"]
    (rows, cols), (west, north) = grid["proj:shape"], (grid["proj:transform"][2], grid["proj:transform"][5])
    window = TileWindow(round(west * unit / tile), round(north * unit / tile) - rows, cols, rows)
    georeference = Georeference(crs, unit, record["metres_per_unit"]["vertical"])
    return Placement(georeference, Grid(tile, record["grid"]["pixels"]), window)


def _footprint(place: Placement) -> dict[str, Any]:
    """Return the outline of the raster and its box, longitude and latitude; no place on Earth is null."""
    try:
        to_degrees = wgs84_transformer(place)
        window = place.window
        corners = (window.col, window.row, window.col + window.cols, window.row + window.rows)
        outlines = polygons_in_wgs84(shapely.polygons([shapely.box(*corners).exterior]), place, to_degrees)
    except BadInputError:
        return {"geometry": None}
    box = BoundingBox()
    box.add(outlines)
    return {"bbox": box.bounds_in_wgs84(), "geometry": shapely.geometry.mapping(outlines[0])}
