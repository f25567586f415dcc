"""run.json, the manifest of a run: inputs, settings, software versions and files, enough to repeat the run.

It holds counts and medians of the map, which are computed in one pass over its tiles.
"""

import hashlib
import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, proj_version_str

from bumpymap.core import (
    BARRED_TEXT,
    CLASS_NAMES,
    NO_CLASS,
    REASON_TEXT,
    SEEN_COLUMNS,
    SEEN_NUMBERS,
    THIN_POINTS,
    BadInputError,
    Barred,
    CostTable,
    Each,
    Nullable,
    Number,
    Reason,
    SeenSizes,
    atomic,
    plain_json,
    read_record,
    shape_fault,
)
from bumpymap.layers.placement import Placement

_STRIP, _OBJECT_STRIP = 65_536, 4_096
"""Most tiles to read at a time, without and with their heights: chosen, 4 MB of heights."""
_OBJECT_HEIGHT = 0.5
"""m: what is lower may be rough ground or grass; chosen."""
_BINS = 1 << 16
"""Bins of each histogram."""
_STEPS = {"c_r": 1 / 8192, "slope": 1 / 512}
"""Width of a histogram bin, rad/m and degrees: an eighth of the last printed digit, up to 8 rad/m and 128 degrees."""
_SEEN_STEPS = dict(zip(SEEN_COLUMNS, (1 / 16, 1 / 2048, 1 / 2048), strict=True))
"""The same of what the survey would have shown, points/m2 and m: up to 4096 points/m2 and 32 m."""

ISLAND_M2 = 500.0
"""Area under which a zone that is not the largest is an island, m2: chosen, 55 tiles of 3 m."""


@dataclass(frozen=True, slots=True)
class ZoneCounts:
    """How the passable tiles of a map hang together."""

    pieces: int
    """Zones that have passable tiles."""
    largest_tiles: int
    """Passable tiles of the largest."""
    largest_m2: float
    """Their area, m2."""
    largest_share: float
    """Their share of all passable tiles, 0..1; 0 without any."""
    islands: int
    """Zones with passable tiles of under ``ISLAND_M2``, without the largest: the last ones."""
    island_tiles: int
    """Passable tiles of these."""

    @classmethod
    def of(cls, sizes: NDArray[np.int64], passable: int, tile_m2: float) -> Self:
        """Count, given the passable tiles of each zone, (m,), of the whole map, and the area of a tile, m2."""
        largest = int(sizes.max(initial=0))
        islands = sizes[(sizes * tile_m2 < ISLAND_M2) & (np.arange(len(sizes)) != sizes.argmax())] if largest else sizes
        share = largest / passable if passable else 0.0
        pieces, lonely = int((sizes > 0).sum()), int((islands > 0).sum())
        return cls(pieces, largest, largest * tile_m2, share, lonely, int(islands.sum()))


def first_island(record: Mapping[str, Any]) -> int | None:
    """Return the first zone that is an island, by run.json: zones are numbered by size, so all after it are too."""
    zones = record.get("counts", {}).get("zones")
    return zones["pieces"] - zones["islands"] + 1 if zones and zones["islands"] else None


@dataclass(frozen=True, slots=True)
class MapSummary:
    """Numbers of tiles by class and reason, and medians.

    Medians come from histograms, so that memory does not grow with the map: those of c_r are accurate to 0.0001 rad/m,
    those of slope to 0.001 degrees; that of the point count is exact up to 65,534.
    """

    tiles: int
    """Number of tiles."""
    points: int
    """Points that were measured."""
    by_class: tuple[int, ...]
    """(4,) tiles of each class."""
    by_reason: tuple[int, ...]
    """(6,) tiles without a class, for each ``Reason``."""
    by_bar: tuple[int, ...]
    """(8,) tiles for each `Barred`, the passable ones first."""
    median_c_r: tuple[float, ...]
    """(5,) rad/m, for each class, then for tiles without a class; NaN if there is no value. That of class 3 is over the
    tiles that their C_r puts there, without those of ``failing``."""
    median_slope: tuple[float, ...]
    """(5,) degrees, likewise."""
    median_count: float
    """Points per tile."""
    failing: int
    """Tiles of class 3 although their C_r is below its limit, because they are too steep or drives fail: their C_r is
    that of the drives that got through."""
    by_holes: int
    """Tiles of class 3 because too few of their pixels hold a point, by the rule of the paper, not by what was measured
    (``compat = "paper"``)."""
    judged: int
    """Tiles with at least 15 points, for the next two."""
    layered: int
    """Those in which the heights inside a pixel have a standard deviation above 0.5 m: surfaces above one another."""
    tall: int
    """Those whose points are more than 0.5 m from the RANSAC plane, on average."""
    seen: SeenSizes
    """Smallest obstacle and step that the survey would have shown in the median tile with a class."""
    zones: ZoneCounts

    @classmethod
    def of(cls, counts: Mapping[str, Any]) -> Self:
        """Read the entry ``counts`` of run.json; medians that are null become NaN."""
        count, *medians = (
            np.array(counts[name], np.float64).tolist() for name in ("median_count", "median_c_r", "median_slope")
        )
        return cls(
            tiles=counts["tiles"],
            points=counts["points"],
            by_class=tuple(counts["by_class"][name] for name in CLASS_NAMES),
            by_reason=tuple(counts["by_reason"].get(REASON_TEXT[code], 0) for code in Reason),
            by_bar=(counts["passable"], *(counts["barred"].get(BARRED_TEXT[code], 0) for code in Barred if code)),
            median_count=count,
            median_c_r=tuple(medians[0]),
            median_slope=tuple(medians[1]),
            failing=counts["failing"],
            by_holes=counts.get("by_holes", 0),
            seen=SeenSizes.of(counts["seen_sizes"]),
            zones=ZoneCounts(**counts["zones"]),
            **counts["objects"],
        )

    @property
    def unknown(self) -> int:
        """Tiles without a class."""
        return self.tiles - sum(self.by_class)

    @property
    def passable(self) -> int:
        """Passable tiles."""
        return self.by_bar[Barred.NO]

    @property
    def bars(self) -> dict[str, int]:
        """Tiles that are not passable, by the description of what bars them; only those that occur."""
        return {BARRED_TEXT[code]: self.by_bar[code] for code in Barred if code and self.by_bar[code]}

    @property
    def crossing(self) -> dict[str, int]:
        """All tiles by what is shown of crossing them: passable, unknown, then what bars the others, if it occurs."""
        return {BARRED_TEXT[Barred.NO]: self.passable, BARRED_TEXT[Barred.UNKNOWN]: 0} | self.bars

    @property
    def classes(self) -> dict[str, int]:
        """Tiles of each class, by its name."""
        return dict(zip(CLASS_NAMES, self.by_class, strict=True))

    @property
    def reasons(self) -> dict[str, int]:
        """Tiles without a class, by the description of the reason; only reasons that occur."""
        return {REASON_TEXT[code]: self.by_reason[code] for code in Reason if self.by_reason[code]}


def summarise(table: CostTable, limits: Sequence[float] | None = None) -> MapSummary:
    """Count the tiles of a map and find the medians; ``limits`` are those between the classes, rad/m."""
    groups = len(CLASS_NAMES) + 1
    spread = {name: np.zeros((groups, _BINS), dtype=np.int64) for name in _STEPS}
    counts = np.zeros((1, _BINS), dtype=np.int64)
    sizes = {name: np.zeros((1, _BINS), dtype=np.int64) for name in _SEEN_STEPS}
    reasons = np.zeros(len(Reason), dtype=np.int64)
    classes = np.zeros(groups, dtype=np.int64)
    barred = np.zeros(len(Barred), dtype=np.int64)
    zones = np.zeros(1, dtype=np.int64)
    points = failing = by_holes = 0
    for strip in table.tiles.strips(_STRIP):
        names = ("class_id", "barred", "reason", "zone", "count", "confidence", *_STEPS, *_SEEN_STEPS)
        found = table.tiles.read(names, strip)
        barred += np.bincount(found["barred"], minlength=len(Barred))
        own = np.bincount(found["zone"][found["barred"] == Barred.NO], minlength=len(zones))
        own[: len(zones)] += zones
        zones = own
        group = np.where(found["class_id"] == NO_CLASS, groups - 1, found["class_id"]).astype(np.int64)
        classes += np.bincount(group, minlength=groups)
        reasons += np.bincount(found["reason"][group == groups - 1], minlength=len(Reason))
        by_holes += int(((found["class_id"] != NO_CLASS) & np.isnan(found["confidence"])).sum())
        points += int(found["count"].sum())
        _count(counts, np.zeros_like(group), found["count"].astype(np.float64))
        known = found["class_id"] != NO_CLASS
        for name, step in _SEEN_STEPS.items():
            _count(sizes[name], np.zeros_like(group[known]), found[name][known] / step)
        if limits is not None:
            fails = (found["class_id"] == len(limits)) & (found["c_r"] < np.float32(limits[-1]))
            failing += int(fails.sum())
            found = {**found, "c_r": np.where(fails, np.nan, found["c_r"])}
        for name, step in _STEPS.items():
            _count(spread[name], group, found[name] / step)
    c_r, slope = (tuple((_median(row) + 0.5) * step for row in spread[name]) for name, step in _STEPS.items())
    return MapSummary(
        tiles=int(classes.sum()),
        points=points,
        by_class=tuple(classes[:-1].tolist()),
        by_reason=tuple(reasons.tolist()),
        by_bar=tuple(barred.tolist()),
        median_c_r=c_r,
        median_slope=slope,
        median_count=_median(counts[0]),
        failing=failing,
        by_holes=by_holes,
        # As `SeenSizes.record` writes them, so that a run that is complete reads the same.
        seen=SeenSizes(*(round((_median(sizes[name][0]) + 0.5) * step, 3) for name, step in _SEEN_STEPS.items())),
        zones=ZoneCounts.of(zones[1:], int(barred[Barred.NO]), table.tiles.grid.tile_size**2),
        **_count_objects(table),
    )


def _count_objects(table: CostTable) -> dict[str, int]:
    """Count the tiles in which something seems to stand on the ground, see `MapSummary`.

    The variance of z inside pixels is that over the points less that of the pixels' means.
    """
    totals = np.zeros(3, dtype=np.int64)
    for strip in table.tiles.strips(_OBJECT_STRIP):
        if (table.tiles.read(("count",), strip)["count"] < THIN_POINTS).all():
            continue
        found = table.tiles.read(("count", "z_variance", "ransac_residual", "heights"), strip)
        judged = found["count"] >= THIN_POINTS
        heights = found["heights"][judged].reshape(int(judged.sum()), -1).astype(np.float64)
        known = np.isfinite(heights)
        pixels = np.maximum(known.sum(axis=1), 1)
        mean = np.where(known, heights, 0.0).sum(axis=1) / pixels
        between = (np.where(known, heights - mean[:, None], 0.0) ** 2).sum(axis=1) / pixels
        layered = found["z_variance"][judged] - between > _OBJECT_HEIGHT**2
        tall = found["ransac_residual"][judged] > _OBJECT_HEIGHT
        totals += [judged.sum(), layered.sum(), tall.sum()]
    return dict(zip(("judged", "layered", "tall"), totals.tolist(), strict=True))


def _count(histogram: NDArray[np.int64], group: NDArray[np.int64], value: NDArray[np.floating]) -> None:
    """Add values, in units of bins, to the histogram of their group; the last bin takes those beyond it."""
    known = np.isfinite(value)
    places = group[known] * _BINS + np.minimum(value[known], _BINS - 1).astype(np.int64)
    histogram += np.bincount(places, minlength=histogram.size).reshape(histogram.shape)


def _median(histogram: NDArray[np.int64]) -> float:
    """Return the bin of the median, the mean of two bins if the count is even; NaN if the histogram is empty."""
    total = np.cumsum(histogram)
    if total[-1] == 0:
        return float("nan")
    middle = np.searchsorted(total, [(total[-1] - 1) // 2, total[-1] // 2], side="right")
    return float(middle.mean())


MANIFEST_NAME = "run.json"
MANIFEST_FORMAT = "bumpymap-run"
COUNT = Number(0, 1e15, whole=True)
"""A number of something in a manifest: whole, and exact as a float."""
_POSITIVE = Number(0, 1e9)
"""Any other number: far beyond what a map can hold, so that arithmetic stays finite."""
_INPUT = {"path": str, "bytes?": Nullable(COUNT), "points?": Nullable(COUNT), "checksum?": Nullable(str)}
_SHAPE: dict[str, Any] = {
    "crs": Nullable({"name": str, "code": Nullable(str), "wkt": str}),
    "metres_per_unit": {"horizontal": Number(1e-6, 1e6), "vertical": Number(1e-6, 1e6)},
    "grid": {"tile_size_m": Number(1e-3, 1e5), "pixels": Number(1, 10_000, whole=True)},
    "files": [{"path": str, "bytes": COUNT, "sha256": str}],
    "survey": {"name": str, "checksum": Nullable(str), "dates": Nullable([str])},
    "inputs": [_INPUT],
    "skipped?": Each(),
    "skipped_inputs?": [{"path": str}],
    "settings": Each(),
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
        "drive_log_sd?": Number(0, 9),
        "slope_limit_deg": Number(0, 90),
        "speeds_mps_at_c_r_radpm": [(Number(1e-9, 1e9),) * 2],
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
        "seen_sizes": dict.fromkeys(SEEN_NUMBERS, Nullable(_POSITIVE)) | {"seen": str},
        "zones": {
            "pieces": COUNT,
            "largest_tiles": COUNT,
            "largest_m2": Number(0, 1e15),
            "largest_share": Number(0, 1),
            "islands": COUNT,
            "island_tiles": COUNT,
        },
    },
}
_VERSION = 2
"""Of run.json: raised where older readers would read it wrongly."""
_PACKAGES = (
    "bumpymap", "laspy", "lazrs", "numpy", "onnxruntime", "pyarrow", "pyogrio", "pypcd4", "pyproj",
    "rasterio", "scipy", "shapely",
)  # fmt: skip


def write_manifest(manifest: Mapping[str, Any], path: Path) -> None:
    """Write a manifest as JSON; the file appears only when it is complete.

    Dataclasses, paths, CRSs and arrays become plain JSON; numbers that are not finite become null. Bytes of a file name
    that are not UTF-8 are written as escaped surrogates (byte E9 as a backslash and udce9), so that `os.fsencode` of
    the parsed string is the name again. Raises OutputError: the file cannot be written.
    """
    text = json.dumps(plain_json(manifest), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with atomic(path) as temporary:
        temporary.write_bytes(text.encode("utf-8", "backslashreplace"))


def complete_manifest(manifest: Mapping[str, Any], table: CostTable, summary: MapSummary) -> dict[str, Any]:
    """Add the entries that follow from the map to a run's own entries.

    ``manifest``: the run's own entries: inputs, settings, model, calibration, vehicle, timings. They are kept. All is
    plain JSON, as it will be read again; there are no ``files`` yet.
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
                "drive_log_sd": table.rule.drive_log_sd,
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
                "seen_sizes": summary.seen.record(),
                "zones": summary.zones,
            },
            "files": [],
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


@cache
def software_versions() -> dict[str, str]:
    """Return the versions of Python, GDAL, PROJ and the packages that the results depend on: looking takes 20 ms."""
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

    Raises BadInputError: the file cannot be read, or changes while it is read.
    """
    size, _, digest = _hashed(path)
    return {"path": str(path), "bytes": size, "sha256": digest}


def describe_input(record: Mapping[str, Any]) -> dict[str, Any]:
    """Add the SHA-256 to the record of an input.

    ``record``: ``path``, and ``bytes`` and ``mtime_ns`` (a string) of the file when the run read it. Raises
    BadInputError: the file cannot be read, or has changed since the run read it, so that its checksum would be wrong.
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
