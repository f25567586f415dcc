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
from bumpymap.scan_products.frame import has_files, write_frame
from bumpymap.scan_products.gather import Gathered, ground_points, open_gathered
from bumpymap.scan_products.looks import COLOURS, NAMES
from bumpymap.scan_products.manifest import write_scan_manifest
from bumpymap.scan_products.names import FRAME_FILES, FRAME_FOLDER, Frame, name_frames, spread_out
from bumpymap.scan_products.part import FramePart, finished_parts, load_part, part_path, save_part
from bumpymap.scan_products.report import FrameReport, report_frame, why_empty
from bumpymap.scan_products.table import SectorTable, open_table, sector_rows

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
    "FramePart",
    "FrameReport",
    "Gathered",
    "SectorTable",
    "check_scan_folder",
    "drop_older",
    "finished_parts",
    "ground_points",
    "has_files",
    "load_part",
    "name_frames",
    "open_gathered",
    "open_table",
    "part_path",
    "report_frame",
    "save_part",
    "sector_rows",
    "spread_out",
    "sync",
    "why_empty",
    "write_frame",
    "write_scan_manifest",
    "writing",
]
