"""Write a map in sheets: each a complete folder of layers, then what leads to them, the manifest last."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import (
    CLASS_NAMES,
    CostTable,
    Progress,
    SilentProgress,
    read_record,
    utf8_path,
    write_csv,
    write_together,
)
from bumpymap.layers.folder import write_products, write_views
from bumpymap.layers.manifest import (
    MANIFEST_NAME,
    SHEETS_FORMAT,
    complete_manifest,
    describe_file,
    write_manifest,
)
from bumpymap.layers.placement import Placement
from bumpymap.layers.products import CATALOG_NAME, EVERY_VIEW_NAME, SHEET_FOLDER, SHEET_TABLE_NAME
from bumpymap.layers.ride_scale import class_limits
from bumpymap.layers.sheets.finished import is_finished, virtual_names
from bumpymap.layers.sheets.folders import (
    make_sheet_folder,
    remove_manifest,
    remove_map_files,
    remove_sheets,
    remove_speeds,
)
from bumpymap.layers.sheets.layout import SheetLayout, SheetPlace
from bumpymap.layers.sheets.virtual import write_virtual
from bumpymap.layers.stac import write_catalog
from bumpymap.layers.summary import STRIP, MapSummary, summarise
from bumpymap.layers.vector import GeoJsonCoordinates
from bumpytiles import TileTable, TileWindow

__all__ = ["SheetRun", "write_sheets"]

_log = logging.getLogger(__name__)


_BOUNDS = ("min_x", "min_y", "max_x", "max_y")


@dataclass(frozen=True, slots=True)
class SheetRun:
    """How a run is written in sheets."""

    layout: SheetLayout
    key: str
    """Tells runs of other inputs, settings or versions apart."""
    keep: bool
    """Whether sheets that an interrupted run with the same key has finished are kept."""
    manifest_of: Callable[[TileWindow], Mapping[str, Any]]
    """Returns the run's own entries for the run.json of a sheet with these tiles."""


def write_sheets(
    table: CostTable,
    folder: Path,
    run: SheetRun,
    *,
    local: bool,
    manifest: Mapping[str, Any],
    progress: Progress | None = None,
) -> tuple[list[Path], MapSummary]:
    """Write the layers of a run in sheets; sheets without tiles are not made.

    The run.json of the whole map is written last, and that of an earlier one is removed first, so a folder that has
    one is complete. So is each sheet that has one. The layers are those of the same map without sheets, cut at the
    edges of sheets; a sheet spans the smallest window around its tiles.

    Parameters
    ----------
    table : CostTable
        The tiles, rated with their neighbours across the edges of sheets.
    folder : Path
        An existing folder, see `check_folder`.
    run : SheetRun
    local : bool
        See `write_products`.
    manifest : mapping
        The run's own entries for the run.json of the whole map, see `complete_manifest`.
    progress : Progress, optional
        Counts the sheets as they are written.

    Returns
    -------
    list of Path
        The virtual rasters, the table of sheets, run.json, the catalogue, and the files of ``EVERY_VIEW_NAME`` for the
        whole map.
    MapSummary
        Counts and medians of the whole map.

    Raises
    ------
    OutputError
        A file cannot be written, or a link stands where a sheet belongs.
    BadInputError
        There is no CRS and ``local`` is False.
    """
    started = time.perf_counter()
    progress = progress or SilentProgress()
    whole = Placement(table.georeference, table.tiles.grid, table.tiles.window)
    GeoJsonCoordinates.of(whole, local=local)  # fails early, as in `write_products`
    places = dict(sorted((run.layout.name(place), place) for place in run.layout.places(table.tiles)))
    remove_manifest(folder)
    progress.start("writing sheets", len(places))
    windows: dict[str, TileWindow] = {}
    for name, place in places.items():
        part = replace(table, tiles=table.tiles.part(run.layout.window(place)))
        windows[f"{SHEET_FOLDER}/{name}"] = part.tiles.window
        _write_sheet(part, make_sheet_folder(folder, name), place, run, around=table.tiles, local=local)
        progress.advance(1)
    summary = summarise(table, class_limits(manifest))
    remove_map_files(folder)
    remove_sheets(folder, keep=places)
    virtual = virtual_names(manifest)
    remove_speeds(folder)
    with write_together(folder, MANIFEST_NAME) as staged, utf8_path(folder) as root:
        for name in virtual:
            write_virtual(staged / name, root, whole, windows)
        sheets = [
            _describe(root, path, place, whole, windows[path])
            for path, place in zip(windows, places.values(), strict=True)
        ]
        _write_table(staged / SHEET_TABLE_NAME, sheets)
        files = [describe_file(staged / name) | {"path": name} for name in (*virtual, SHEET_TABLE_NAME)]
        record = complete_manifest(manifest, table, summary, files)
        record |= {
            "format": SHEETS_FORMAT,
            "sheet_side_m": run.layout.side * whole.grid.tile_size,
            "sheets": sheets,
        }
    with utf8_path(folder) as root:
        write_views(root, record)
        write_catalog(root, list(windows), title=_title(record))
        record["seconds"] = {**manifest.get("seconds", {}), "write": round(time.perf_counter() - started, 3)}
        write_manifest(record, root / MANIFEST_NAME)
    _log.info("wrote %d tiles in %d sheets to %s", summary.tiles, len(places), folder)
    views = [name for name in EVERY_VIEW_NAME if (folder / name).is_file()]
    return [folder / name for name in (*virtual, SHEET_TABLE_NAME, MANIFEST_NAME, CATALOG_NAME, *views)], summary


def _write_sheet(
    table: CostTable, sheet: Path, place: SheetPlace, run: SheetRun, *, around: TileTable, local: bool
) -> None:
    """Write one sheet, unless an interrupted run has finished it."""
    about = {"name": sheet.name, "column": place[0], "row": place[1], "side_tiles": run.layout.side, "run": run.key}
    if run.keep and is_finished(sheet, about):
        return
    own = {**run.manifest_of(table.tiles.window), "sheet": about, "points": _points(table.tiles), "seconds": {}}
    write_products(table, sheet, local=local, manifest=own, around=around)


def _points(tiles: TileTable) -> int:
    return sum(int(tiles.read(("count",), strip)["count"].sum()) for strip in tiles.strips(STRIP))


def _describe(root: Path, path: str, place: SheetPlace, whole: Placement, window: TileWindow) -> dict[str, Any]:
    """Return what the manifest of the map says of a sheet; ``root`` is the folder that ``path`` is relative to."""
    corners = np.array([window.col, window.row, window.col + window.cols, window.row + window.rows])
    record = read_record(root / path / MANIFEST_NAME) or {}
    counts = record["counts"]
    return {
        "folder": path,
        "column": place[0],
        "row": place[1],
        "bounds": whole.to_crs(corners).tolist(),
        "points": counts["points"],
        **{name: counts[name] for name in ("tiles", "classified", "unknown", "passable", "by_class")},
        "bytes": sum(file["bytes"] for file in record["files"]),
        "sha256": describe_file(root / path / MANIFEST_NAME)["sha256"],
    }


def _write_table(path: Path, sheets: Sequence[Mapping[str, Any]]) -> None:
    """Write sheets.csv, one row a sheet."""
    numbers = ("points", "tiles", *(name.replace(" ", "_") for name in CLASS_NAMES), "unknown", "passable", "bytes")
    rows = []
    for sheet in sheets:
        classes = {name.replace(" ", "_"): count for name, count in sheet["by_class"].items()}
        values = {**sheet, **classes}
        places = (f"{side:.10g}" for side in sheet["bounds"])
        rows.append((sheet["folder"], sheet["column"], sheet["row"], *places, *(values[name] for name in numbers)))
    write_csv(path, ("folder", "column", "row", *_BOUNDS, *numbers), rows, end="\n")


def _title(record: Mapping[str, Any]) -> str:
    survey = record.get("survey")
    name = survey.get("name") if isinstance(survey, Mapping) else None
    return str(name or "Map in sheets")
