"""The folder of a run: checked before the long work, filled after it, the manifest last."""

import logging
import re
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from uuid import uuid4

from bumpymap.errors import OutputError
from bumpymap.products.geotiff import write_classes, write_heightmap, write_roughness
from bumpymap.products.manifest import MANIFEST_NAME, complete_manifest, write_manifest
from bumpymap.products.regions import dissolve
from bumpymap.products.table import write_tiles
from bumpymap.products.vector import place_regions, write_flatgeobuf, write_geojson
from bumpymap.types import CostMap

__all__ = ["PRODUCT_NAMES", "check_folder", "write_products"]

PRODUCT_NAMES: tuple[str, ...] = (
    "roughness.tif",
    "class.tif",
    "heightmap.tif",
    "tiles.parquet",
    "cost.geojson",
    "cost.fgb",
    MANIFEST_NAME,
)
"""Files of a run, in the order of writing. ``class.tif.aux.xml`` belongs to class.tif: GDAL's category names."""

_log = logging.getLogger(__name__)


def check_folder(folder: Path, *, overwrite: bool) -> None:
    """Make sure that the products of a run can be written to a folder; create it where it is missing.

    What a killed run left half-written there goes away.

    Raises
    ------
    OutputError
        It cannot be created or written, or it holds the products of a run and ``overwrite`` is False.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"cannot write to the folder {folder}: it is a file. Choose another --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".bumpymap-{uuid4().hex}"
        probe.touch()
        probe.unlink()
        _sweep(folder)
        present = [name for name in PRODUCT_NAMES if (folder / name).exists()]
    except OSError as error:
        raise OutputError(
            f"cannot write to the folder {folder}: {error.strerror or error}. "
            "Choose one that can be written, with --out"
        ) from error
    blocked = [name for name in present if not (folder / name).is_file()]
    if blocked:
        raise OutputError(f"{folder / blocked[0]} is not a file, so it cannot be replaced. Choose another --out")
    if present and not overwrite:
        unfinished = "" if PRODUCT_NAMES[-1] in present else " of a run that did not end"
        raise OutputError(
            f"{folder} already holds {', '.join(present)}{unfinished}. Choose another --out, "
            "or pass --overwrite to replace them"
        )


def _sweep(folder: Path) -> None:
    """Remove the scratch files of a run that was killed; see `atomic` for their names."""
    stems = "|".join({re.escape(Path(name).stem) for name in PRODUCT_NAMES})
    for left in folder.iterdir():
        if re.match(rf"\.({stems})\.[0-9a-f]{{32}}\.", left.name) and left.is_file():
            left.unlink(missing_ok=True)


def write_products(cost_map: CostMap, folder: Path, *, local: bool, manifest: Mapping[str, Any]) -> list[Path]:
    """Write every file of a run; run.json is the last, so a folder that has one is complete.

    Files of an earlier run are replaced one by one, each whole. Nothing in the files but run.json depends on time, on
    the order of the tiles, or on names of folders: the same map gives the same bytes.

    Parameters
    ----------
    cost_map : CostMap
        Tiles in any order, at least one.
    folder : Path
        An existing folder, see `check_folder`.
    local : bool
        Write cost.geojson in the survey's own coordinates where the survey has no CRS.
    manifest : mapping
        What the run knows about itself, see `complete_manifest`.

    Returns
    -------
    list of Path
        The files, in the order of ``PRODUCT_NAMES``.

    Raises
    ------
    OutputError
        The place cannot be written.
    BadInputError
        No tiles; they span too much for a raster; no CRS and ``local`` is False.
    """
    paths = [folder / name for name in PRODUCT_NAMES]
    started = time.perf_counter()
    facts = _facts(manifest)
    tags = {key: str(value) for key, value in facts.items()}
    roughness, klass, heightmap, tiles, geojson, flatgeobuf, run = paths
    regions = dissolve(cost_map)
    # First what may be refused: the survey's CRS may have no relation to longitude and latitude.
    placed = place_regions(regions, local=local)
    _forget(run)
    write_geojson(regions, geojson, local=local, about=facts, placed=placed)
    write_flatgeobuf(regions, flatgeobuf)
    write_roughness(cost_map, roughness, tags)
    write_classes(cost_map, klass, tags)
    write_heightmap(cost_map, heightmap, tags)
    write_tiles(cost_map, tiles)
    record = complete_manifest(manifest, cost_map, paths[:-1])
    record["seconds"] = {**manifest.get("seconds", {}), "write": round(time.perf_counter() - started, 3)}
    write_manifest(record, run)
    _log.info("wrote %d tiles in %d regions to %s", len(cost_map.klass), len(regions.tiles), folder)
    return paths


def _forget(run: Path) -> None:
    """Remove the manifest of an earlier run: from here on it would describe other files."""
    try:
        run.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"cannot replace {run}: {error}. Choose another --out") from error


def _facts(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Pick what a layer should say about its making: vehicle, calibration, texture model."""
    calibration = manifest.get("calibration")
    facts = dict(calibration) if isinstance(calibration, Mapping) else {"id": calibration}
    picked = {"vehicle": facts.get("vehicle"), "calibration": facts.get("id"), "texture_model": manifest.get("model")}
    return {key: value for key, value in picked.items() if isinstance(value, str)}
