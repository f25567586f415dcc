"""The output folder of a map: check it before the run, write all files after it, the manifest last."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import partial
from os.path import lexists
from pathlib import Path
from threading import Event
from typing import Any
from uuid import uuid4

from bumpymap.core import STAGED, CostTable, OutputError, Progress, SilentProgress, remove_path, write_together
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
from bumpymap.layers.regions import dissolve
from bumpymap.layers.summary import MapSummary, summarise
from bumpymap.layers.table import write_tiles
from bumpymap.layers.vector import GeoJsonCoordinates, flatgeobuf_writer, geojson_writer

__all__ = ["NAMED_RASTERS", "PRODUCT_NAMES", "check_folder", "write_products"]

PRODUCT_NAMES: tuple[str, ...] = (
    "roughness.tif",
    "class.tif",
    "cost.tif",
    "barred.tif",
    "heightmap.tif",
    "obstacle.tif",
    "tiles.parquet",
    "cost.geojson",
    "cost.fgb",
    MANIFEST_NAME,
)
"""Files of a run."""
NAMED_RASTERS = ("class.tif", "barred.tif", "obstacle.tif")
"""Rasters beside which GDAL writes the names of their values, to ``class.tif.aux.xml`` and so on."""

_log = logging.getLogger(__name__)


def check_folder(folder: Path, *, overwrite: bool, resume: bool = False) -> None:
    """Check that the files of a run can be written to a folder; create the folder if it is missing.

    Half-written files of a killed run are removed; the caller holds the lock of the folder, so no other run is using
    it. A file that is a symbolic link will be replaced as a link; its target is not touched.

    Parameters
    ----------
    folder : Path
        The output folder.
    overwrite : bool
        Allow files of any earlier run to be replaced.
    resume : bool
        Allow files of an incomplete run (without run.json) to be replaced.

    Raises
    ------
    OutputError
        The folder cannot be created or written, or holds files that must not be replaced.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"cannot write to the folder {folder}: it is a file. Choose another `out`")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".bumpymap-{uuid4().hex}"
        probe.touch()
        probe.unlink()
        for left in folder.glob(f"{STAGED}*"):  # of a run that was killed
            remove_path(left)
        present = [name for name in PRODUCT_NAMES if lexists(folder / name)]
    except OSError as error:
        raise OutputError(
            f"cannot write to the folder {folder}: {error.strerror or error}. "
            "Choose one that can be written, with `out`"
        ) from error
    blocked = [name for name in present if not (folder / name).is_symlink() and not (folder / name).is_file()]
    if blocked:
        raise OutputError(f"{folder / blocked[0]} is not a file, so it cannot be replaced. Choose another `out`")
    finished = MANIFEST_NAME in present
    if present and not overwrite and (finished or not resume):
        unfinished = "" if finished else " of a run that did not end"
        raise OutputError(
            f"{folder} already holds {', '.join(present)}{unfinished}. Choose another `out`, "
            "or pass `overwrite=True` to replace them"
        )


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
        The files, in the order of ``PRODUCT_NAMES``.
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
        write_manifest(record, staged / MANIFEST_NAME)
    _log.info("wrote %d tiles to %s", summary.tiles, folder)
    return [folder / name for name in PRODUCT_NAMES], summary


def _layers(
    table: CostTable, coordinates: GeoJsonCoordinates, folder: Path, provenance: dict[str, Any]
) -> list[dict[tuple[str, ...], Callable[[], None]]]:
    """Return groups of functions that write layers, keyed by file names; a group is written one by one.

    All rasters are in one group: GDAL loses pixels if two threads write rasters, see `_integrity`.
    """
    tags = {key: str(value) for key, value in provenance.items()}
    return [
        {
            ("heightmap.tif",): partial(write_heightmap, table, folder / "heightmap.tif", tags),
            ("obstacle.tif",): partial(write_obstacles, table, folder / "obstacle.tif", tags),
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
