"""run.json: what went in, with which settings and software, what came out; enough to repeat the run."""

import hashlib
import json
import math
import platform
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from pyproj import CRS, proj_version_str

from bumpymap.atomic import atomic
from bumpymap.errors import BadInputError
from bumpymap.types import CLASS_NAMES, NO_CLASS, REASON_TEXT, CostMap, Reason

__all__ = ["MANIFEST_NAME", "complete_manifest", "describe_file", "software_versions", "summarise", "write_manifest"]

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


def complete_manifest(manifest: Mapping[str, Any], cost_map: CostMap, files: list[Path]) -> dict[str, Any]:
    """Add to a run's own record what can be told from its map and files.

    Parameters
    ----------
    manifest : mapping
        What the run knows: ``inputs`` (records with a ``path``; size and checksum are added), settings, model,
        calibration, timings. Its entries are kept.
    cost_map : CostMap
        The map.
    files : list of Path
        Products that were written.

    Returns
    -------
    dict
        With ``format``, ``version``, ``versions``, ``crs``, ``grid``, ``counts`` and ``files`` beside.
    """
    inputs = [_complete_input(record) for record in manifest.get("inputs", ())]
    return {
        "format": _FORMAT,
        "version": _VERSION,
        **manifest,
        "inputs": inputs,
        "versions": software_versions() | dict(manifest.get("versions", {})),
        **summarise(cost_map),
        "files": [describe_file(path) | {"path": path.name} for path in files],
    }


def summarise(cost_map: CostMap) -> dict[str, Any]:
    """Place and size of a map: ``crs``, ``grid``, ``counts`` by class and by reason."""
    place, patches = cost_map.georeference, cost_map.patches
    known = cost_map.klass[cost_map.klass != NO_CLASS]
    by_class = np.bincount(known, minlength=len(CLASS_NAMES))
    by_reason = np.bincount(patches.reason[cost_map.klass == NO_CLASS], minlength=len(Reason))
    return {
        "crs": None
        if place.crs is None
        else {"name": place.crs.name, "code": _code(place.crs), "wkt": place.crs.to_wkt()},
        "metres_per_unit": {"horizontal": place.metres_per_unit, "vertical": place.metres_per_unit_z},
        "grid": {"tile_size_m": patches.grid.tile_size, "pixels": patches.grid.pixels},
        "ride_weight_m_per_rad": cost_map.ride_weight,
        "counts": {
            "tiles": len(patches.col),
            "classified": len(known),
            "unknown": len(patches.col) - len(known),
            "points": int(patches.count.sum()),
            "by_class": {name: int(count) for name, count in zip(CLASS_NAMES, by_class, strict=True)},
            "by_reason": {REASON_TEXT[code]: int(by_reason[code]) for code in Reason if by_reason[code]},
        },
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


def _complete_input(record: Any) -> dict[str, Any]:
    known = dict(record) if isinstance(record, Mapping) else {"path": record}
    return describe_file(Path(known["path"])) | known


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
