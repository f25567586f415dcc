"""The settings of a calibration, its drive jobs, and its record of the drives. A job depends only on the settings.

There are two kinds of jobs. Each cell of the table follows the paper: one of four textures, scaled to a height range.
The ride model is fitted to the terrain library: ground of many kinds with a wide range of heights and slopes. Of the
library, a calibration stores the drives, not the ground, which follows from the seed. A ride model can therefore be
fitted again from the file, without driving and with the same bits.
"""

import math
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from importlib.metadata import version
from typing import Any

import numpy as np

from bumpymap.core import TEXTURES, BadInputError, UsageError
from bumpymap.lab.simulate.drive import DriveSettings, Effort, PatchDrives, drive_patch
from bumpymap.lab.simulate.jobs import Key
from bumpymap.lab.worlds.terrains import KINDS, Terrain, make_terrain
from bumpymap.rating import Calibration, DrivenTerrain, Vehicle, make_textures

_LIBRARY_STREAM = len(TEXTURES)
"""First number of the random streams of library drives; no texture has this index."""
_LIBRARY_WHEEL_M = 0.3
"""The library's heights suit wheels of this radius; for other radii they are scaled."""


def log_spaced(lowest: float, highest: float, count: int) -> tuple[float, ...]:
    """Return ``count`` values from ``lowest`` to ``highest`` in equal ratios, rounded to three digits."""
    return tuple(float(f"{value:.3g}") for value in np.geomspace(lowest, highest, count))


@dataclass(frozen=True, slots=True)
class CalibrationSettings:
    """All settings that affect the numbers of a calibration."""

    profile: Vehicle
    seed: int = 1
    patches: int = 8
    """Patches per cell of the table (texture and z range)."""
    starts: int = 3
    """Drives per patch of the table, each with its own start and heading."""
    z_range: tuple[float, ...] = log_spaced(0.02, 2.5, 14)
    """max - min of the table's plane-removed patches, m."""
    terrains: int = 24
    """Terrains of each kind of the library."""
    terrain_starts: int = 8
    """Drives per terrain."""
    tile_size: float = 3.0
    """Side of a patch, m."""
    pixels: int = 15
    drive: DriveSettings = field(default_factory=DriveSettings)

    def __post_init__(self) -> None:
        lowest = {"seed": 0, "patches": 2, "starts": 1, "terrains": 1, "terrain_starts": 2, "pixels": 4}
        for name, least in lowest.items():
            if getattr(self, name) < least:
                raise UsageError(f"`{name}` is {getattr(self, name)}; it must be {least} or more")
        if not (math.isfinite(self.tile_size) and self.tile_size > 0):
            raise UsageError(f"`tile_size` is {self.tile_size}; it must be a positive number of metres")
        if list(self.z_range) != sorted(set(self.z_range)) or not self.z_range or self.z_range[0] <= 0:
            raise UsageError(f"z ranges are {self.z_range}; they must be positive and rise from one to the next")

    def quick(self) -> "CalibrationSettings":
        """Return a copy with a quarter of the drives: enough for a ride model, coarse for the table."""
        z_range = log_spaced(self.z_range[0], self.z_range[-1], 6)
        return replace(self, patches=4, starts=1, z_range=z_range, terrains=16, terrain_starts=4)

    @property
    def total_drives(self) -> int:
        """Number of drives of the whole calibration."""
        return sum(job.starts for job in self.jobs())

    def jobs(self) -> Iterator["TableJob | LibraryJob"]:
        """Yield all jobs: the table cell by cell, then the library kind by kind."""
        for texture in range(len(TEXTURES)):
            for z in range(len(self.z_range)):
                for patch in range(self.patches):
                    yield TableJob(texture, z, patch, self.starts)
        for kind in KINDS:
            for index in range(self.terrains):
                yield LibraryJob(kind, index, self.terrain_starts)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings that affect the numbers and the library versions, as plain JSON values."""
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("profile", "drive")}
        versions = {name: version(name) for name in ("bumpymap", "dartpy", "numpy")}
        return {
            "vehicle": self.profile.to_dict(),
            **own | {"z_range": list(self.z_range)},
            "drive": asdict(self.drive),
            "versions": {**versions, "python": platform.python_version(), "machine": platform.machine()},
        }


@dataclass(frozen=True, slots=True)
class TableJob:
    """Drives over one patch of the table: indices of texture, z range and patch."""

    texture: int
    z: int
    patch: int
    starts: int

    @property
    def key(self) -> Key:
        """Name of the job in a journal."""
        return ("table", self.texture, self.z, self.patch)


@dataclass(frozen=True, slots=True)
class LibraryJob:
    """Drives over one terrain of the library, for the ``purpose`` that its key begins with."""

    kind: str
    index: int
    starts: int
    purpose: str = "library"

    @property
    def key(self) -> Key:
        """Name of the job in a journal."""
        return (self.purpose, self.kind, self.index)


def calibrated_settings(calibration: Calibration) -> CalibrationSettings:
    """Return the settings of the vehicle, the seed and the tiles that a calibration was made with."""
    return CalibrationSettings(
        Vehicle.from_dict(calibration.vehicle, f"calibration {calibration.id}"),
        seed=int(calibration.settings.get("seed", 1)),
        tile_size=calibration.tile_size,
        pixels=calibration.pixels,
    )


def library_terrain(settings: CalibrationSettings, kind: str, index: int) -> Terrain:
    """Make a terrain of the library for the vehicle: the height that a wheel climbs is proportional to its radius."""
    return make_terrain(
        kind,
        settings.seed,
        index,
        height_scale=settings.profile.wheel.radius_m / _LIBRARY_WHEEL_M,
        slope_limit_deg=settings.profile.slope_limit_deg,
        tile_size=settings.tile_size,
        pixels=settings.pixels,
    )


def run_job(settings: CalibrationSettings, job: TableJob | LibraryJob) -> PatchDrives:
    """Make the ground of a job and drive over it.

    Ground and starts have their own random streams, derived from the seed and the job's indices, so the result does not
    depend on the process or on earlier jobs.
    """
    if isinstance(job, TableJob):
        stream: tuple[int, ...] = (job.texture, job.z, job.patch)
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=stream))
        patch = make_textures(TEXTURES[job.texture], 1, rng, settings.pixels)[0]
        heights = patch.astype(np.float64) * settings.z_range[job.z]
    else:
        stream = (_LIBRARY_STREAM, KINDS.index(job.kind), job.index)
        heights = library_terrain(settings, job.kind, job.index).heights
    effort = Effort.fixed(job.starts)
    return drive_patch(
        settings.profile, heights, settings.tile_size, settings.seed, effort, settings.drive, stream=stream
    )


_COLUMNS = tuple(f.name for f in fields(DrivenTerrain) if f.name not in ("kind", "index"))


def driven_library(settings: CalibrationSettings, results: Mapping[Key, PatchDrives]) -> tuple[DrivenTerrain, ...]:
    """Summarise the drives over the library, kind by kind; C_r is rounded to six digits, as in the file."""
    return tuple(
        DrivenTerrain(
            kind=kind,
            index=index,
            c_r=six_digits(drives.mean_c_r),
            c_r_error=six_digits(drives.standard_error),
            completed=len(drives.completed),
            stuck=drives.outcome.count("stuck"),
            rolled=drives.outcome.count("rolled"),
        )
        for kind in KINDS
        for index in range(settings.terrains)
        for drives in (results["library", kind, index],)
    )


def library_ground(settings: CalibrationSettings, driven: Sequence[DrivenTerrain]) -> list[Terrain]:
    """Regenerate the ground of driven terrains."""
    return [library_terrain(settings, terrain.kind, terrain.index) for terrain in driven]


def library_record(driven: Sequence[DrivenTerrain]) -> dict[str, dict[str, list[Any]]]:
    """Return the entry of a calibration file: kind -> column -> one value per terrain, ordered by index."""
    record: dict[str, dict[str, list[Any]]] = {}
    for terrain in driven:
        for name in _COLUMNS:
            record.setdefault(terrain.kind, {}).setdefault(name, []).append(getattr(terrain, name))
    return record


def library_terrains(calibration: Calibration) -> tuple[DrivenTerrain, ...]:
    """Read the driven terrains from a calibration.

    Raises
    ------
    BadInputError
        The record is damaged.
    """
    try:
        return tuple(
            DrivenTerrain(kind, index, **dict(zip(_COLUMNS, values, strict=True)))
            for kind, columns in calibration.settings["library"].items()
            for index, values in enumerate(zip(*(columns[name] for name in _COLUMNS), strict=True))
        )
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise BadInputError(
            f"the record of the terrain library in the calibration {calibration.id} is damaged: {error!r}. "
            "Make it again with: bumpymap calibrate --vehicle FILE --out CALIBRATION.json"
        ) from error


def read_library(calibration: Calibration) -> tuple[list[Terrain], tuple[DrivenTerrain, ...]]:
    """Return the ground and the drives of the terrain library of a calibration, the inputs of `fit_ride`.

    Raises
    ------
    BadInputError
        The record is damaged.
    """
    driven = library_terrains(calibration)
    return library_ground(calibrated_settings(calibration), driven), driven


def six_digits(value: float | None) -> float | None:
    """Round a figure as it is recorded; None for None and NaN."""
    return None if value is None or math.isnan(value) else float(f"{value:.6g}")
