"""The last stage of a run: its layers, in one folder or in sheets."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bumpymap.core import CostTable, MapConfig, Progress, recorded_place
from bumpymap.layers import MapSummary, remove_sheets
from bumpymap.survey.inputs import SurveyInputs
from bumpytiles import BLOCK_TILES, Bounds, TileWindow

__all__ = ["write_layers"]

_COMPARED = ("inputs", "settings", "made with")


def write_layers(
    table: CostTable,
    config: MapConfig,
    inputs: SurveyInputs,
    run_spec: Mapping[str, Any],
    manifest: Mapping[str, Any],
    progress: Progress,
) -> tuple[tuple[Path, ...], MapSummary, int]:
    """Write the layers; return the files, the statistics of the map, and the number of sheets, 0 for one map.

    For errors see `bumpymap.layers.write_products` and `bumpymap.layers.write_sheets`.
    """
    # These bring GDAL and Arrow, for which reading need not wait.
    from bumpymap.layers import SheetRun, write_products, write_sheets

    if inputs.sheets is None:
        files, summary = write_products(table, config.out, local=config.local, manifest=manifest, progress=progress)
        remove_sheets(config.out)  # of an earlier run
        return tuple(files), summary, 0

    extents = {recorded_place(reader.info.path): reader.info.bounds for reader in inputs.readers}

    def manifest_of(window: TileWindow) -> dict[str, Any]:
        # Only the files that matter: there may be thousands of files and hundreds of sheets.
        near = table.tiles.grid.window_bounds(_with_ring(window))
        return {**manifest, "inputs": [file for file in manifest["inputs"] if _meets(extents[str(file["path"])], near)]}

    compared = json.dumps({name: run_spec[name] for name in _COMPARED}, sort_keys=True)
    key = hashlib.sha256(compared.encode("utf-8", "backslashreplace")).hexdigest()
    run = SheetRun(inputs.sheets, key, config.resume, manifest_of)
    files, summary = write_sheets(table, config.out, run, local=config.local, manifest=manifest, progress=progress)
    return tuple(files), summary, len(inputs.sheets.places(table.tiles))


def _with_ring(window: TileWindow) -> TileWindow:
    """Add a block on each side: tiles depend on their neighbours, and points may lie a little outside of extents."""
    ring = BLOCK_TILES
    return TileWindow(window.col - ring, window.row - ring, window.cols + 2 * ring, window.rows + 2 * ring)


def _meets(extent: Bounds | None, box: Bounds) -> bool:
    """Return whether a file whose points have this extent (None: unknown) may have some in a box."""
    return extent is None or (
        extent.west <= box.east and extent.east >= box.west and extent.south <= box.north and extent.north >= box.south
    )
