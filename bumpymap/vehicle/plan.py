"""What a calibration drives: settings, and the jobs they spell out. A job depends on nothing but the settings."""

import math
import platform
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from typing import Any

import numpy as np

from bumpymap.errors import UsageError
from bumpymap.textures import make_textures
from bumpymap.types import TEXTURES
from bumpymap.vehicle.drive import DriveSettings, Outcome, drive
from bumpymap.vehicle.profile import VehicleProfile
from bumpymap.vehicle.terrain import PatchGround

__all__ = ["CalibrationSettings", "Job", "PatchDrives", "log_spaced", "run_job"]


def log_spaced(lowest: float, highest: float, count: int) -> tuple[float, ...]:
    """``count`` values from ``lowest`` to ``highest`` in equal ratios, three digits each."""
    return tuple(float(f"{value:.3g}") for value in np.geomspace(lowest, highest, count))


@dataclass(frozen=True, slots=True)
class CalibrationSettings:
    """Everything that decides the numbers of a calibration."""

    profile: VehicleProfile
    seed: int = 1
    patches: int = 16
    """Patches of one cell (texture and z range)."""
    starts: int = 3
    """Drives over one patch, each from its own start and heading."""
    z_range: tuple[float, ...] = log_spaced(0.02, 2.5, 14)
    """max - min of the plane-removed patches, m."""
    tile_size: float = 3.0
    """Side of a patch, m."""
    pixels: int = 15
    drive: DriveSettings = field(default_factory=DriveSettings)

    def __post_init__(self) -> None:
        for name, lowest in (("seed", 0), ("patches", 2), ("starts", 1), ("pixels", 4)):
            if getattr(self, name) < lowest:
                raise UsageError(f"{name} is {getattr(self, name)}; it must be {lowest} or more")
        if not (math.isfinite(self.tile_size) and self.tile_size > 0):
            raise UsageError(f"tile size is {self.tile_size}; it must be a positive number of metres")
        if list(self.z_range) != sorted(set(self.z_range)) or not self.z_range or self.z_range[0] <= 0:
            raise UsageError(f"z ranges are {self.z_range}; they must be positive and rise")

    @property
    def total_drives(self) -> int:
        """Number of drives of the whole calibration."""
        return len(TEXTURES) * len(self.z_range) * self.patches * self.starts

    def jobs(self) -> Iterator["Job"]:
        """Every job, cell by cell."""
        for texture in range(len(TEXTURES)):
            for z in range(len(self.z_range)):
                for patch in range(self.patches):
                    yield Job(texture, z, patch)

    def to_dict(self) -> dict[str, Any]:
        """Return what decides the numbers, with the versions of what computes them, as JSON has it."""
        return {
            "vehicle": self.profile.to_dict(),
            "seed": self.seed,
            "patches": self.patches,
            "starts": self.starts,
            "z_range": list(self.z_range),
            "tile_size": self.tile_size,
            "pixels": self.pixels,
            "drive": asdict(self.drive),
            "versions": {
                **{name: version(name) for name in ("bumpymap", "dartpy", "numpy")},
                "python": platform.python_version(),
                "machine": platform.machine(),
            },
        }


@dataclass(frozen=True, slots=True)
class Job:
    """One patch to drive over: indices of texture, z range and patch."""

    texture: int
    z: int
    patch: int


@dataclass(frozen=True, slots=True)
class PatchDrives:
    """What the drives over one patch gave, in the order of the starts."""

    outcome: tuple[Outcome, ...]
    c_r: tuple[float | None, ...]
    """rad/m; None unless completed."""

    @property
    def mean_c_r(self) -> float | None:
        """Mean over the completed drives, rad/m; None without one."""
        completed = [value for value in self.c_r if value is not None]
        return math.fsum(completed) / len(completed) if completed else None

    @property
    def failed(self) -> int:
        """Drives that rolled over or got stuck."""
        return sum(outcome != "completed" for outcome in self.outcome)


def run_job(settings: CalibrationSettings, job: Job) -> PatchDrives:
    """Make the patch of a job and drive over it.

    Patch and starts have random streams of their own, derived from the seed and the job's indices: which process runs
    the job, and what ran before it, changes nothing.
    """
    stream = (job.texture, job.z, job.patch)
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=stream))
    patch = make_textures(TEXTURES[job.texture], 1, rng, settings.pixels)[0]
    ground = PatchGround.from_heights(patch.astype(np.float64) * settings.z_range[job.z], settings.tile_size)
    drives = [
        drive(settings.profile, ground, _seed(settings.seed, (*stream, start)), settings.drive)
        for start in range(settings.starts)
    ]
    return PatchDrives(
        outcome=tuple(d.outcome for d in drives),
        c_r=tuple(d.c_r if d.outcome == "completed" else None for d in drives),
    )


def _seed(seed: int, stream: tuple[int, ...]) -> int:
    return int(np.random.SeedSequence(seed, spawn_key=stream).generate_state(1, np.uint64)[0])
