"""run.json: what went in, with which settings and software, what came out; enough to repeat the run."""

import hashlib
import json
import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from pyproj import CRS, proj_version_str

from bumpymap.atomic import atomic
from bumpymap.errors import BadInputError
from bumpymap.products.summary import MapSummary
from bumpymap.types import CostMosaic

__all__ = [
    "MANIFEST_NAME",
    "complete_manifest",
    "describe_file",
    "describe_input",
    "software_versions",
    "write_manifest",
]

MANIFEST_NAME = "run.json"
_FORMAT = "bumpymap-run"
_VERSION = 1
_PACKAGES = (
    "bumpymap", "laspy", "lazrs", "numba", "numpy", "onnxruntime", "plyfile", "pyarrow", "pyogrio", "pypcd4", "pyproj",
    "rasterio", "scipy", "shapely",
)  # fmt: skip


def write_manifest(manifest: Mapping[str, Any], path: Path) -> None:
    """Write a manifest as JSON, whole or not at all.

    Records, paths, CRSs and arrays become plain JSON; numbers that are not finite become null.

    Raises
    ------
    OutputError
        The place cannot be written.
    """
    text = json.dumps(_plain(manifest), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def complete_manifest(
    manifest: Mapping[str, Any],
    mosaic: CostMosaic,
    summary: MapSummary,
    inputs: Sequence[Mapping[str, Any]],
    files: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """Add to a run's own record what can be told from its map and files.

    Parameters
    ----------
    manifest : mapping
        What the run knows: settings, model, calibration, timings. Its entries are kept.
    mosaic : CostMosaic
        The map.
    summary : MapSummary
        Of that map.
    inputs, files : sequences of mappings
        From `describe_input` and `describe_file`.

    Returns
    -------
    dict
        With ``format``, ``version``, ``versions``, ``crs``, ``grid``, ``counts`` and ``files`` beside.
    """
    place, grid = mosaic.georeference, mosaic.tiles.grid
    crs = place.crs
    return {
        "format": _FORMAT,
        "version": _VERSION,
        **manifest,
        "inputs": list(inputs),
        "versions": software_versions() | dict(manifest.get("versions", {})),
        "crs": None if crs is None else {"name": crs.name, "code": _code(crs), "wkt": crs.to_wkt()},
        "metres_per_unit": {"horizontal": place.metres_per_unit, "vertical": place.metres_per_unit_z},
        "grid": {"tile_size_m": grid.tile_size, "pixels": grid.pixels},
        "ride_weight_m_per_rad": mosaic.ride_weight,
        "counts": {
            "tiles": summary.tiles,
            "classified": summary.tiles - summary.unknown,
            "unknown": summary.unknown,
            "points": summary.points,
            "by_class": summary.classes,
            "by_reason": summary.reasons,
            "median_c_r": summary.median_c_r,
            "median_slope": summary.median_slope,
            "median_count": summary.median_count,
        },
        "files": [dict(file) for file in files],
    }


def software_versions() -> dict[str, str]:
    """Versions of everything that has a say in the numbers."""
    versions = {"python": platform.python_version(), "gdal": rasterio.__gdal_version__, "proj": proj_version_str}
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return dict(sorted(versions.items()))


def describe_file(path: Path) -> dict[str, Any]:
    """Size in bytes and SHA-256 of a file.

    Raises
    ------
    BadInputError
        It cannot be read.
    """
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        return {"path": str(path), "bytes": path.stat().st_size, "sha256": digest}
    except OSError as error:
        raise BadInputError(f"cannot read {path} to take its checksum: {error}") from error


def describe_input(record: Mapping[str, Any]) -> dict[str, Any]:
    """Add size and checksum to what a run knows of an input.

    A record that has both already (None where nobody knows, as for an URL) is not read again.

    Raises
    ------
    BadInputError
        It cannot be read.
    """
    known = dict(record)
    return known if {"bytes", "sha256"} <= known.keys() else describe_file(Path(known["path"])) | known


def _code(crs: CRS) -> str | None:
    authority = crs.to_authority()
    return None if authority is None else ":".join(authority)


def _plain(value: Any) -> Any:
    """Turn any value of a manifest into what JSON knows."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
