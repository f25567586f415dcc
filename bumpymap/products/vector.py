"""The cost map as regions: cost.geojson on the globe, cost.fgb in the survey's CRS."""

import json
import warnings
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import mapping

from bumpymap.atomic import atomic
from bumpymap.errors import BadInputError
from bumpymap.products.lonlat import bounding_box, outlines_in_crs, outlines_on_globe
from bumpymap.products.regions import Regions
from bumpymap.types import NO_CLASS

__all__ = ["place_regions", "write_flatgeobuf", "write_geojson"]

_LOCAL = (
    "x and y are the survey's own coordinates, not longitude and latitude: its place on Earth is not "
    "known. This file is therefore not RFC 7946 GeoJSON"
)


def write_geojson(
    regions: Regions,
    path: Path,
    *,
    local: bool,
    about: Mapping[str, Any] | None = None,
    placed: tuple[NDArray[np.object_], dict[str, Any]] | None = None,
) -> None:
    """Write cost.geojson: RFC 7946, one feature a region, WGS 84 with 7 decimals.

    Parameters
    ----------
    regions : Regions
        From `dissolve`.
    path : Path
        The file.
    local : bool
        Where the survey has no CRS, write its own coordinates, rounded to 1 mm, with a member that says so.
    about : mapping, optional
        Further members of the feature collection, such as vehicle and calibration.
    placed : tuple, optional
        What `place_regions` gives, where it was asked already.

    Raises
    ------
    BadInputError
        The survey has no CRS and ``local`` is False; or its CRS has no relation to longitude and latitude.
    OutputError
        The place cannot be written.
    """
    outlines, place = placed or place_regions(regions, local=local)
    head = {"type": "FeatureCollection", "name": "cost", **place, **(about or {})}
    columns = _columns(regions)
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(json.dumps(head, ensure_ascii=False, allow_nan=False)[:-1])
        file.write(', "features": [\n')
        for number, outline in enumerate(outlines):
            properties = {name: values[number] for name, values in columns.items()}
            feature = {"type": "Feature", "properties": properties, "geometry": mapping(outline)}
            file.write(",\n" if number else "")
            file.write(json.dumps(feature, ensure_ascii=False, allow_nan=False))
        file.write("\n]}\n")


def place_regions(regions: Regions, *, local: bool) -> tuple[NDArray[np.object_], dict[str, Any]]:
    """Place outlines as cost.geojson has them, with the members of the collection that say where they are.

    Raises
    ------
    BadInputError
        The survey has no CRS, or one without relation to longitude and latitude, and ``local`` is False.
    """
    try:
        outlines = outlines_on_globe(regions)
    except BadInputError:
        if not local:
            raise
        outlines = shapely.transform(outlines_in_crs(regions), lambda points: points.round(3))
        return outlines, {
            "bbox": [float(side) for side in shapely.total_bounds(outlines)],
            "local_coordinates": _LOCAL,
            "metres_per_unit": regions.placement.georeference.metres_per_unit,
        }
    return outlines, {"bbox": bounding_box(outlines)}


def write_flatgeobuf(regions: Regions, path: Path) -> None:
    """Write cost.fgb: the regions of `write_geojson`, in the survey's CRS (none where it has none).

    Raises
    ------
    OutputError
        The place cannot be written.
    """
    # pyogrio loads pandas and geopandas where they are installed, which takes a while: only when it is needed.
    from pyogrio.errors import DataLayerError, DataSourceError, FeatureError, FieldError, GeometryError
    from pyogrio.raw import write

    failures = (DataLayerError, DataSourceError, FeatureError, FieldError, GeometryError)
    crs = regions.placement.horizontal_crs
    columns = _columns(regions)
    kinds = {"class": np.int32, "tiles": np.int64, "class_name": object, "reason": object}
    masks = [np.array([value is None for value in values]) for values in columns.values()]
    # Through memory: GDAL does not notice when a disk fills up in the last few bytes (seen in 3.8 and 3.12), and takes
    # what follows a '!' in a path for a part of an archive.
    content = BytesIO()
    with atomic(path, failures) as temporary, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="'crs' was not provided")
        write(
            content,
            geometry=shapely.to_wkb(outlines_in_crs(regions), byte_order=1),
            field_data=[_filled(values, kinds.get(name, np.float64)) for name, values in columns.items()],
            field_mask=masks,
            fields=list(columns),
            layer="cost",
            driver="FlatGeobuf",
            geometry_type="Polygon",
            crs=None if crs is None else crs.to_wkt(),
        )
        temporary.write_bytes(content.getbuffer())


def _columns(regions: Regions) -> dict[str, list[Any]]:
    """Properties of the regions as Python values, None where there is nothing to say."""
    known = regions.klass != NO_CLASS
    return {
        "class": [int(value) if is_known else None for value, is_known in zip(regions.klass, known, strict=True)],
        "class_name": list(regions.class_name),
        "reason": [None if is_known else text for text, is_known in zip(regions.reason_text, known, strict=True)],
        "c_r": _numbers(regions.c_r, 6),
        "c_r_low": _numbers(regions.c_r_low, 6),
        "c_r_high": _numbers(regions.c_r_high, 6),
        "p_fail": _numbers(regions.p_fail, 6),
        "cost": _numbers(regions.cost, 6),
        "area_m2": _numbers(regions.area_m2, 3),
        "tiles": regions.tiles.tolist(),
    }


def _numbers(values: NDArray[np.float64], decimals: int) -> list[float | None]:
    rounded: list[float] = values.round(decimals).tolist()
    return [value if is_number else None for value, is_number in zip(rounded, np.isfinite(values), strict=True)]


def _filled(values: list[Any], kind: type) -> NDArray[Any]:
    """Make an array of a column; what stands in for None is masked."""
    blank = "" if kind is object else 0
    return np.array([blank if value is None else value for value in values], dtype=kind)
