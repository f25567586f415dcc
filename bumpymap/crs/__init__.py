"""Coordinate reference systems and units: what a file and its user say, made into one ``Georeference``."""

from bumpymap.crs.reproject import Place, describe_crs, reproject_command, utm_epsg
from bumpymap.crs.settle import (
    CrsStatement,
    common_georeference,
    crs_from_epsg,
    georeference,
    horizontal_of,
    linear_unit,
    parse_crs,
    same_crs,
    scale_note,
    statement_from_wkt,
    unit_name,
)
from bumpymap.crs.vertical import vertical_of, with_vertical

__all__ = [
    "CrsStatement",
    "Place",
    "common_georeference",
    "crs_from_epsg",
    "describe_crs",
    "georeference",
    "horizontal_of",
    "linear_unit",
    "parse_crs",
    "reproject_command",
    "same_crs",
    "scale_note",
    "statement_from_wkt",
    "unit_name",
    "utm_epsg",
    "vertical_of",
    "with_vertical",
]
