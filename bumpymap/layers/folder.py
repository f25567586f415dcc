"""Write all files of a map to its folder, the manifest last."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

from bumpymap.core import CostTable, Progress, SilentProgress, write_together
from bumpymap.layers.geotiff import (
    write_barred,
    write_classes,
    write_cost,
    write_heightmap,
    write_obstacles,
    write_roughness,
)
from bumpymap.layers.manifest import MANIFEST_NAME, complete_manifest, describe_file, write_manifest
from bumpymap.layers.placement import Placement
from bumpymap.layers.products import ITEM_NAME, PRODUCT_NAMES, VIEW_NAMES
from bumpymap.layers.regions import dissolve
from bumpymap.layers.stac import write_item
from bumpymap.layers.summary import MapSummary, summarise
from bumpymap.layers.table import write_tiles
from bumpymap.layers.vector import GeoJsonCoordinates, flatgeobuf_writer, geojson_writer

__all__ = ["write_products"]

_log = logging.getLogger(__name__)
_VIEWS: tuple[Callable[[Path, Mapping[str, Any]], None], ...] = ()
"""Write the files of ``VIEW_NAMES`` to a folder, from the layers in it and the record of its run."""


def write_products(
    table: CostTable, folder: Path, *, local: bool, manifest: Mapping[str, Any], progress: Progress | None = None
) -> tuple[list[Path], MapSummary]:
    """Write all files of a run, or none; run.json is written last, so a folder that has one is complete.

    Files of an earlier run stay until all new ones are complete. Except for run.json, no file depends on the time, on
    the order of the tiles or on folder names: the same map has the same bytes.

    Parameters
    ----------
    table : CostTable
        The tiles.
    folder : Path
        An existing folder, see `check_folder`.
    local : bool
        Write cost.geojson in the survey's own coordinates if it has no CRS.
    manifest : mapping
        The run's own entries for run.json, see `complete_manifest`.
    progress : Progress, optional
        Counts the layers as they are written.

    Returns
    -------
    list of Path
        The files, in the order of ``PRODUCT_NAMES`` and ``VIEW_NAMES``.
    MapSummary
        Counts and medians of the map.

    Raises
    ------
    OutputError
        A file cannot be written.
    BadInputError
        The extent is too large for a raster, or there is no CRS and ``local`` is False.
    """
    started = time.perf_counter()
    placement = Placement.of(table)
    # Fail early: there may be no transformation from the survey's CRS to longitude and latitude.
    coordinates = GeoJsonCoordinates.of(placement, local=local)
    progress = progress or SilentProgress()
    with write_together(folder, MANIFEST_NAME) as staged, ThreadPoolExecutor(1) as background:
        counting = background.submit(summarise, table)
        try:
            layers = _write_layers(_layers(table, coordinates, staged, _provenance(manifest)), staged, progress)
            summary = counting.result()
        finally:
            background.shutdown(wait=False, cancel_futures=True)
        record = complete_manifest(manifest, table, summary, layers)
        record["seconds"] = {**manifest.get("seconds", {}), "write": round(time.perf_counter() - started, 3)}
        for view in _VIEWS:
            view(staged, record)
        write_item(staged, record)
        record["files"].append(describe_file(staged / ITEM_NAME) | {"path": ITEM_NAME})
        write_manifest(record, staged / MANIFEST_NAME)
    _log.info("wrote %d tiles to %s", summary.tiles, folder)
    return [folder / name for name in (*PRODUCT_NAMES, *VIEW_NAMES)], summary


def _layers(
    table: CostTable, coordinates: GeoJsonCoordinates, folder: Path, provenance: dict[str, Any]
) -> list[dict[tuple[str, ...], Callable[[], None]]]:
    """Return groups of functions that write layers, keyed by file names; a group is written one by one.

    Rasters take turns where GDAL writes them, see `_integrity`; two groups of them save time where it does not.
    """
    tags = {key: str(value) for key, value in provenance.items()}
    return [
        {
            ("heightmap.tif",): partial(write_heightmap, table, folder / "heightmap.tif", tags),
            ("obstacle.tif",): partial(write_obstacles, table, folder / "obstacle.tif", tags),
        },
        {
            ("roughness.tif",): partial(write_roughness, table, folder / "roughness.tif", tags),
            ("class.tif",): partial(write_classes, table, folder / "class.tif", tags),
            ("cost.tif",): partial(write_cost, table, folder / "cost.tif", tags),
            ("barred.tif",): partial(write_barred, table, folder / "barred.tif", tags),
        },
        {
            ("cost.geojson", "cost.fgb"): partial(_write_regions, table, coordinates, folder, provenance),
            ("tiles.parquet",): partial(write_tiles, table, folder / "tiles.parquet"),
        },
    ]


def _write_layers(
    groups: Sequence[Mapping[tuple[str, ...], Callable[[], None]]], folder: Path, progress: Progress
) -> list[dict[str, Any]]:
    """Write groups of layers in parallel; return name, size and checksum of each file in ``PRODUCT_NAMES`` order."""
    stop = Event()

    def write(group: Mapping[tuple[str, ...], Callable[[], None]]) -> list[dict[str, Any]]:
        files = []
        for names, layer in group.items():
            if stop.is_set():
                break
            layer()
            files += [describe_file(folder / name) | {"path": name} for name in names]
            progress.advance(1)
        return files

    progress.start("writing layers", sum(map(len, groups)))
    with ThreadPoolExecutor(len(groups)) as pool:
        try:
            futures = [pool.submit(write, group) for group in groups]
            files = [file for future in as_completed(futures) for file in future.result()]
        finally:
            stop.set()
    return sorted(files, key=lambda file: PRODUCT_NAMES.index(file["path"]))


def _write_regions(
    table: CostTable, coordinates: GeoJsonCoordinates, folder: Path, provenance: Mapping[str, Any]
) -> None:
    placement = coordinates.placement
    with (
        geojson_writer(folder / "cost.geojson", coordinates, provenance) as write_geojson,
        flatgeobuf_writer(folder / "cost.fgb", placement) as write_flatgeobuf,
    ):
        for regions in dissolve(table, placement):
            write_geojson(regions)
            write_flatgeobuf(regions)


def _provenance(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of a manifest that layers carry as metadata: vehicle, calibration, texture model."""
    calibration = manifest.get("calibration")
    known = dict(calibration) if isinstance(calibration, Mapping) else {"id": calibration}
    entries = {"vehicle": known.get("vehicle"), "calibration": known.get("id"), "texture_model": manifest.get("model")}
    return {key: value for key, value in entries.items() if isinstance(value, str)}
