"""The folder of a run: checked before the long work, filled after it, the manifest last."""

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
from bumpymap.layers.geotiff import write_classes, write_cost, write_heightmap, write_roughness
from bumpymap.layers.manifest import MANIFEST_NAME, complete_manifest, describe_file, describe_input, write_manifest
from bumpymap.layers.placement import Placement
from bumpymap.layers.regions import dissolve
from bumpymap.layers.summary import MapSummary, summarise
from bumpymap.layers.table import write_tiles
from bumpymap.layers.vector import GeoJsonPlace, flatgeobuf_writer, geojson_writer

__all__ = ["PRODUCT_NAMES", "check_folder", "write_products"]

PRODUCT_NAMES: tuple[str, ...] = (
    "roughness.tif",
    "class.tif",
    "cost.tif",
    "heightmap.tif",
    "tiles.parquet",
    "cost.geojson",
    "cost.fgb",
    MANIFEST_NAME,
)
"""Files of a run. ``class.tif.aux.xml`` belongs to class.tif: GDAL's category names."""

_log = logging.getLogger(__name__)


def check_folder(folder: Path, *, overwrite: bool, resume: bool = False) -> None:
    """Make sure that the products of a run can be written to a folder; create it where it is missing.

    What a killed run left half-written there goes away; the caller holds the lock of the folder, so no other run is
    at it. A product that is a link is replaced itself, what it points to stays.

    Parameters
    ----------
    folder : Path
        The folder.
    overwrite : bool
        Products of any run may be replaced.
    resume : bool
        Products of a run that did not end (without run.json) may be replaced.

    Raises
    ------
    OutputError
        It cannot be created or written, or it holds products that may not be replaced.
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
    """Write every file of a run, all or none; run.json comes last, so a folder that has one is complete.

    Files of an earlier run stay until all the new ones are complete. Nothing in the files but run.json depends on time,
    on the order of the tiles, or on names of folders: the same map gives the same bytes.

    Parameters
    ----------
    mosaic : CostTable
        The tiles.
    folder : Path
        An existing folder, see `check_folder`.
    local : bool
        Write cost.geojson in the survey's own coordinates where the survey has no CRS.
    manifest : mapping
        What the run knows about itself, see `complete_manifest`; ``inputs`` are records with a ``path``, to which size
        and checksum are added, see `describe_input`.
    progress : Progress, optional
        Counts the layers as they are written.

    Returns
    -------
    list of Path
        The files, in the order of ``PRODUCT_NAMES``.
    MapSummary
        What they hold.

    Raises
    ------
    OutputError
        The place cannot be written.
    BadInputError
        The tiles span too much for a raster; no CRS and ``local`` is False; an input is gone.
    """
    started = time.perf_counter()
    placement = Placement.of(table)
    # First what may be refused: the survey's CRS may have no relation to longitude and latitude.
    globe = GeoJsonPlace.of(placement, local=local)
    progress = progress or SilentProgress()
    with write_together(folder, MANIFEST_NAME) as staged, ThreadPoolExecutor(1) as beside:
        counting = beside.submit(summarise, table)
        inputs = [beside.submit(describe_input, record) for record in manifest.get("inputs", ())]
        try:
            layers = _write_layers(_layers(table, globe, staged, _facts(manifest)), staged, progress)
            summary = counting.result()
            known = [future.result() for future in inputs]
        finally:
            beside.shutdown(wait=False, cancel_futures=True)
        record = complete_manifest(manifest, table, summary, known, layers)
        record["seconds"] = {**manifest.get("seconds", {}), "write": round(time.perf_counter() - started, 3)}
        write_manifest(record, staged / MANIFEST_NAME)
    _log.info("wrote %d tiles to %s", summary.tiles, folder)
    return [folder / name for name in PRODUCT_NAMES], summary


def _layers(
    table: CostTable, globe: GeoJsonPlace, folder: Path, facts: dict[str, Any]
) -> list[dict[tuple[str, ...], Callable[[], None]]]:
    """Give what writes each layer, by the names of its files; layers of one group are written one after the other.

    GDAL's cache loses pixels where two threads write rasters, see `_whole`.
    """
    tags = {key: str(value) for key, value in facts.items()}
    return [
        {
            ("heightmap.tif",): partial(write_heightmap, table, folder / "heightmap.tif", tags),
            ("roughness.tif",): partial(write_roughness, table, folder / "roughness.tif", tags),
            ("class.tif",): partial(write_classes, table, folder / "class.tif", tags),
            ("cost.tif",): partial(write_cost, table, folder / "cost.tif", tags),
        },
        {
            ("cost.geojson", "cost.fgb"): partial(_write_regions, table, globe, folder, facts),
            ("tiles.parquet",): partial(write_tiles, table, folder / "tiles.parquet"),
        },
    ]


def _write_layers(
    groups: Sequence[Mapping[tuple[str, ...], Callable[[], None]]], folder: Path, progress: Progress
) -> list[dict[str, Any]]:
    """Write groups of layers side by side; give name, size and checksum of each file, in the order of the names."""
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


def _write_regions(table: CostTable, globe: GeoJsonPlace, folder: Path, facts: Mapping[str, Any]) -> None:
    place = globe.placement
    with (
        geojson_writer(folder / "cost.geojson", globe, facts) as to_globe,
        flatgeobuf_writer(folder / "cost.fgb", place) as to_flat,
    ):
        for regions in dissolve(table, place):
            to_globe(regions)
            to_flat(regions)


def _facts(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Pick what a layer should say about its making: vehicle, calibration, texture model."""
    calibration = manifest.get("calibration")
    facts = dict(calibration) if isinstance(calibration, Mapping) else {"id": calibration}
    picked = {"vehicle": facts.get("vehicle"), "calibration": facts.get("id"), "texture_model": manifest.get("model")}
    return {key: value for key, value in picked.items() if isinstance(value, str)}
