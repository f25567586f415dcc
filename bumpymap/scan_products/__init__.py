"""The files of a scan run: classed sectors in, polygons, clouds, pictures, a table and a gathered survey out."""

from bumpymap.scan_products.folder import (
    GATHERED,
    MANIFEST,
    MAP_FOLDER,
    TABLE,
    check_scan_folder,
    drop_older,
    sync,
    writing,
)
from bumpymap.scan_products.frame import write_frame
from bumpymap.scan_products.gather import Gathered, open_gathered
from bumpymap.scan_products.looks import COLOURS, NAMES
from bumpymap.scan_products.manifest import write_scan_manifest
from bumpymap.scan_products.names import FRAME_FILES, FRAME_FOLDER, Frame, name_frames, spread_out
from bumpymap.scan_products.report import FrameReport, report_frame, why_empty
from bumpymap.scan_products.table import SectorTable, open_table

__all__ = [
    "COLOURS",
    "FRAME_FILES",
    "FRAME_FOLDER",
    "GATHERED",
    "MANIFEST",
    "MAP_FOLDER",
    "NAMES",
    "TABLE",
    "Frame",
    "FrameReport",
    "Gathered",
    "SectorTable",
    "check_scan_folder",
    "drop_older",
    "name_frames",
    "open_gathered",
    "open_table",
    "report_frame",
    "spread_out",
    "sync",
    "why_empty",
    "write_frame",
    "write_scan_manifest",
    "writing",
]
