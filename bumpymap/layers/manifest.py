"""run.json, the manifest of a run: inputs, settings, software versions and files, enough to repeat the run."""

import hashlib
import json
import os
import platform
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from pyproj import CRS, proj_version_str

from bumpymap.core import (
    CLASS_NAMES,
    BadInputError,
    CostTable,
    Each,
    Nullable,
    Number,
    atomic,
    plain_json,
    read_record,
    shape_fault,
)
from bumpymap.layers.placement import Placement
from bumpymap.layers.summary import MapSummary

MANIFEST_NAME = "run.json"
MANIFEST_FORMAT = "bumpymap-run"
COUNT = Number(0, 1e15, whole=True)
PLACE_SHAPE: dict[str, Any] = {
    "crs": Nullable({"name": str, "code": Nullable(str), "wkt": str}),
    "metres_per_unit": {"horizontal": Number(1e-6, 1e6), "vertical": Number(1e-6, 1e6)},
    "grid": {"tile_size_m": Number(1e-3, 1e5), "pixels": Number(1, 10_000, whole=True)},
    "files": [{"path": str, "bytes": COUNT, "sha256": str}],
}
"""Shape of what manifests of maps and of comparisons say of their place and files."""
_POSITIVE = Number(0, 1e9)
_INPUT = {"path": str, "bytes?": Nullable(COUNT), "points?": Nullable(COUNT), "checksum?": Nullable(str)}
_SHAPE: dict[str, Any] = PLACE_SHAPE | {
    "survey": {"name": str, "checksum": Nullable(str), "dates": Nullable([str])},
    "inputs": [_INPUT],
    "skipped?": Each(),
    "skipped_inputs?": [{"path": str}],
    "settings": {"speeds?": Nullable([_POSITIVE])},
    "versions": Each(str),
    "points": COUNT,
    "model": Nullable(str),
    "calibration": {"id": str, "vehicle": str, "class_limits": (_POSITIVE,) * 3},
    "vehicle": {"name": str, "width_m": _POSITIVE, "height_m": _POSITIVE, "speed_mps": _POSITIVE},
    "seconds": Each(_POSITIVE),
    "cost": {
        "ride_weight_m_per_rad": _POSITIVE,
        "fail_weight_m": _POSITIVE,
        "drive_m": _POSITIVE,
        "slope_limit_deg": Number(0, 90),
    },
    "counts": {
        "tiles": COUNT,
        "points": COUNT,
        "passable": COUNT,
        "unknown": COUNT,
        "by_class": dict.fromkeys(CLASS_NAMES, COUNT),
        "by_reason": Each(COUNT),
        "barred": Each(COUNT),
        "median_c_r": (Nullable(_POSITIVE),) * 5,
        "median_slope": (Nullable(_POSITIVE),) * 5,
        "median_count": Nullable(_POSITIVE),
        "failing": COUNT,
        "objects": {"judged": COUNT, "layered": COUNT, "tall": COUNT},
    },
}
_VERSION = 2
_PACKAGES = (
    "bumpymap", "laspy", "lazrs", "numba", "numpy", "onnxruntime", "pyarrow", "pyogrio", "pypcd4", "pyproj",
    "rasterio", "scipy", "shapely",
)  # fmt: skip


def write_manifest(manifest: Mapping[str, Any], path: Path) -> None:
    """Write a manifest as JSON; the file appears only when it is complete.

    Dataclasses, paths, CRSs and arrays become plain JSON; numbers that are not finite become null. Bytes of a file name
    that are not UTF-8 are written as escaped surrogates (byte E9 as a backslash and udce9), so that `os.fsencode` of
    the parsed string is the name again.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    text = json.dumps(plain_json(manifest), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with atomic(path) as temporary:
        temporary.write_bytes(text.encode("utf-8", "backslashreplace"))


def complete_manifest(
    manifest: Mapping[str, Any],
    table: CostTable,
    summary: MapSummary,
    files: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """Add the entries that follow from the map and its files to a run's own entries.

    Parameters
    ----------
    manifest : mapping
        The run's own entries: inputs, settings, model, calibration, vehicle, timings. They are kept.
    table : CostTable
        The map.
    summary : MapSummary
        Counts and medians of that map.
    files : sequence of mappings
        From `describe_file`.

    Returns
    -------
    dict
        Also with ``format``, ``version``, ``versions``, ``crs``, ``grid``, ``cost``, ``counts`` and ``files``; all as
        plain JSON, as it will be read again.
    """
    record: dict[str, Any] = plain_json(
        {
            "format": MANIFEST_FORMAT,
            "version": _VERSION,
            **manifest,
            "versions": software_versions() | dict(manifest.get("versions", {})),
            **place_entries(Placement.of(table)),
            "cost": {
                "ride_weight_m_per_rad": table.rule.ride_weight,
                "fail_weight_m": table.rule.fail_weight,
                "drive_m": table.rule.drive_m,
                "slope_limit_deg": table.rule.slope_limit_deg,
                "speeds_mps_at_c_r_radpm": [[speed, c_r] for c_r, speed in table.rule.speeds],
            },
            "counts": {
                "tiles": summary.tiles,
                "classified": summary.tiles - summary.unknown,
                "unknown": summary.unknown,
                "passable": summary.passable,
                "barred": summary.bars,
                "points": summary.points,
                "by_class": summary.classes,
                "by_reason": summary.reasons,
                "failing": summary.failing,
                **({"by_holes": summary.by_holes} if summary.by_holes else {}),
                "median_c_r": summary.median_c_r,
                "median_slope": summary.median_slope,
                "median_count": summary.median_count,
                "objects": {"judged": summary.judged, "layered": summary.layered, "tall": summary.tall},
            },
            "files": [dict(file) for file in files],
        }
    )
    return record


def place_entries(placement: Placement) -> dict[str, Any]:
    """Return the entries of a manifest that say where its files lie: ``crs``, ``metres_per_unit`` and ``grid``."""
    place, grid, crs = placement.georeference, placement.grid, placement.height_crs
    return {
        "crs": None if crs is None else {"name": crs.name, "code": _code(crs), "wkt": crs.to_wkt()},
        "metres_per_unit": {"horizontal": place.metres_per_unit, "vertical": place.metres_per_unit_z},
        "grid": {"tile_size_m": grid.tile_size, "pixels": grid.pixels},
    }


def software_versions() -> dict[str, str]:
    """Return the versions of Python, GDAL, PROJ and the packages that the results depend on."""
    return dict(_versions())


@cache
def _versions() -> dict[str, str]:
    """Look the versions up, once: that takes 20 ms."""
    import rasterio

    versions = {"python": platform.python_version(), "gdal": rasterio.__gdal_version__, "proj": proj_version_str}
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return dict(sorted(versions.items()))


def describe_file(path: Path) -> dict[str, Any]:
    """Return path, size in bytes and SHA-256 of a file.

    Raises
    ------
    BadInputError
        The file cannot be read, or changes while it is read.
    """
    size, _, digest = _hashed(path)
    return {"path": str(path), "bytes": size, "sha256": digest}


def describe_input(record: Mapping[str, Any]) -> dict[str, Any]:
    """Add the SHA-256 to the record of an input.

    Parameters
    ----------
    record : mapping
        ``path``, and ``bytes`` and ``mtime_ns`` (a string) of the file when the run read it.

    Raises
    ------
    BadInputError
        The file cannot be read, or has changed since the run read it, so that its checksum would be wrong.
    """
    path = Path(record["path"])
    size, changed, digest = _hashed(path)
    if (record["bytes"], record["mtime_ns"]) != (size, changed):
        raise _changed(path)
    return {**record, "sha256": digest}


def _hashed(path: Path) -> tuple[int, str, str]:
    """Return size, modification time and SHA-256 of a file; raise BadInputError if it changes meanwhile."""
    try:
        with path.open("rb") as file:
            before = os.fstat(file.fileno())
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            after = os.fstat(file.fileno())
    except OSError as error:
        raise BadInputError(f"cannot read {path} to take its checksum: {error}") from error
    if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
        raise _changed(path)
    return before.st_size, str(before.st_mtime_ns), digest


def _changed(path: Path) -> BadInputError:
    return BadInputError(
        f"{path} changed while the run was in progress, so its checksum would not be that of the data that was read; "
        "nothing was written. Run again when no other program writes to it, or on a copy"
    )


def _code(crs: CRS) -> str | None:
    """Return a code such as EPSG:32614, or EPSG:32614+5703 if only the two parts of a compound CRS have codes."""
    authority = crs.to_authority()
    if authority is not None:
        return ":".join(authority)
    parts = [part.to_authority() for part in crs.sub_crs_list] if crs.is_compound else []
    if not parts or any(part is None or part[0] != "EPSG" for part in parts):
        return None
    return "EPSG:" + "+".join(part[1] for part in parts)


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read the manifest of a complete map. Raises BadInputError if there is none, or one of another version."""
    remedy = "Give the folder that `bumpymap map` wrote"
    if not folder.is_dir():
        what = f"{folder} is a file" if folder.exists() else f"there is no folder {folder}"
        raise BadInputError(f"{what}. {remedy}")
    record = read_record(folder / MANIFEST_NAME)
    if record is None or not str(record.get("format")).startswith("bumpymap-"):
        is_scan = (folder / "scan.json").exists()
        hint = f"The map of this drive is in {folder / 'map'}" if is_scan else remedy
        raise BadInputError(f"{folder} holds no complete run: {MANIFEST_NAME} is missing or not that of a map. {hint}")
    if (record["format"], record.get("version")) != (MANIFEST_FORMAT, _VERSION):
        raise BadInputError(f"{folder} holds a map of another version of bumpymap. Map the survey again")
    if fault := shape_fault(record, _SHAPE):
        raise BadInputError(f"{folder / MANIFEST_NAME} is damaged: {fault}. Map the survey again")
    return record
