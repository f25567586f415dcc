"""The files of a run: rasters, regions, table and manifest. ``CostMosaic`` in, files out."""

from bumpymap.products.complete import complete_record, is_complete, refuse_replacing
from bumpymap.products.folder import PRODUCT_NAMES, check_folder, write_products
from bumpymap.products.geotiff import CLASS_COLOURS, write_classes, write_cost, write_heightmap, write_roughness
from bumpymap.products.manifest import (
    MANIFEST_NAME,
    complete_manifest,
    describe_file,
    describe_input,
    software_versions,
    write_manifest,
)
from bumpymap.products.placement import MAX_PIXELS, MAX_TILES, Placement, check_extent
from bumpymap.products.regions import Regions, dissolve
from bumpymap.products.summary import MapSummary, summarise
from bumpymap.products.table import write_tiles
from bumpymap.products.vector import GeoJsonPlace, flatgeobuf_writer, geojson_writer

__all__ = [
    "CLASS_COLOURS",
    "MANIFEST_NAME",
    "MAX_PIXELS",
    "MAX_TILES",
    "PRODUCT_NAMES",
    "GeoJsonPlace",
    "MapSummary",
    "Placement",
    "Regions",
    "check_extent",
    "check_folder",
    "complete_manifest",
    "complete_record",
    "describe_file",
    "describe_input",
    "dissolve",
    "flatgeobuf_writer",
    "geojson_writer",
    "is_complete",
    "refuse_replacing",
    "software_versions",
    "summarise",
    "write_classes",
    "write_cost",
    "write_heightmap",
    "write_manifest",
    "write_products",
    "write_roughness",
    "write_tiles",
]
