"""Drive a vehicle over a part of the terrain library at several speeds.

Every start is driven at every speed, so that what a terrain does at one place does not blur what the speed does.
"""

import math
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.lab.simulate.drive import Start
from bumpymap.lab.simulate.journal import JobJournal, Key
from bumpymap.lab.simulate.model import require_dart
from bumpymap.lab.simulate.motion_drive import MotionDrive, drive_motion
from bumpymap.lab.simulate.plan import CalibrationSettings, library_terrain
from bumpymap.lab.simulate.pool import Progress, drive_jobs
from bumpymap.lab.simulate.terrain import PatchGround
from bumpymap.lab.worlds import KINDS

__all__ = [
    "MotionEffort",
    "MotionJob",
    "MotionRecord",
    "drive_library",
    "motion_jobs",
    "motion_journal",
]

_STREAM = 102
"""Number of the random stream of these drives."""


@dataclass(frozen=True, slots=True)
class MotionEffort:
    """How much is driven."""

    terrains: int = 6
    """Terrains of each kind of the library."""
    starts: int = 2
    """Starts on each terrain."""
    ratios: tuple[float, ...] = (0.5, 1.0, 2.0)
    """Speeds of each start over the profile's."""

    @classmethod
    def of(cls, settings: CalibrationSettings) -> "MotionEffort":
        """Return the effort of a calibration: a quarter of its terrains, and of its drives over each."""
        return cls(max(2, settings.terrains // 4), max(1, settings.terrain_starts // 4))

    @property
    def total(self) -> int:
        """Number of all drives."""
        return self.drives * self.terrains * len(KINDS)

    @property
    def drives(self) -> int:
        """Drives over one terrain."""
        return self.starts * len(self.ratios)


@dataclass(frozen=True, slots=True)
class MotionJob:
    """Drives over one terrain of the library."""

    kind: str
    index: int
    starts: int
    """Number of all drives."""

    @property
    def key(self) -> Key:
        """Name of the job in a journal."""
        return ("motion", self.kind, self.index)


@dataclass(frozen=True, slots=True)
class MotionRecord:
    """Drives over one terrain: ``[start][speed]``; None unless completed."""

    c_r: tuple[tuple[float | None, ...], ...]
    """rad/m."""
    c_roll: tuple[tuple[float | None, ...], ...]
    """rad/m."""
    a_w: tuple[tuple[float | None, ...], ...]
    """m/s2."""

    @classmethod
    def of(cls, drives: list[list[MotionDrive]]) -> "MotionRecord":
        """Collect drives, ``[start][speed]``."""
        return cls(*(tuple(tuple(_known(getattr(d, name)) for d in row) for row in drives) for name in cls.__slots__))

    @classmethod
    def read(cls, fields: dict[str, Any]) -> "MotionRecord":
        """Read the fields of a journal."""
        return cls(*(tuple(tuple(row) for row in fields[name]) for name in cls.__slots__))


def motion_jobs(effort: MotionEffort) -> list[MotionJob]:
    """Return all jobs: the terrains of the library, index by index, so that a part of them has all kinds."""
    return [MotionJob(kind, index, effort.drives) for index in range(effort.terrains) for kind in KINDS]


def run_motion(settings: CalibrationSettings, effort: MotionEffort, job: MotionJob) -> MotionRecord:
    """Drive over a terrain; every start has its own random stream, derived from the seed and the job."""
    profile = settings.profile
    heights = library_terrain(settings, job.kind, job.index).heights
    ground = PatchGround.from_heights(heights, settings.tile_size)
    made = []
    for number in range(effort.starts):
        stream = (_STREAM, KINDS.index(job.kind), job.index, number)
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=stream))
        easting, northing, turn = rng.random(3).tolist()
        start = Start(easting * ground.extent, northing * ground.extent, turn * 2 * math.pi)
        made.append([drive_motion(profile, ground, start, ratio * profile.speed_mps) for ratio in effort.ratios])
    return MotionRecord.of(made)


def drive_library(
    settings: CalibrationSettings,
    effort: MotionEffort,
    progress: Progress | None = None,
    *,
    workers: int = 1,
    journal: JobJournal[MotionRecord] | None = None,
    discard_other: bool = False,
) -> dict[Key, MotionRecord]:
    """Drive over the first terrains of every kind; for the other parameters see `drive_jobs`."""
    require_dart()
    return drive_jobs(
        partial(run_motion, settings, effort),
        motion_jobs(effort),
        progress,
        workers=workers,
        journal=journal,
        discard_other=discard_other,
    )


def motion_journal(path: Path, settings: CalibrationSettings, effort: MotionEffort) -> JobJournal[MotionRecord]:
    """Return the journal of such drives."""
    versions = {name: version(name) for name in ("dartpy", "numpy")}
    profile = settings.profile.to_dict()
    about = {"seed": settings.seed, "tile_size": settings.tile_size, "pixels": settings.pixels, "vehicle": profile}
    effort_record = {name: value for name, value in asdict(effort).items() if name != "terrains"}
    plain = {**about, "effort": {k: list(v) if isinstance(v, tuple) else v for k, v in effort_record.items()}}
    return JobJournal(path, plain | {"versions": versions}, MotionRecord.read)


def _known(value: float) -> float | None:
    return None if math.isnan(value) else float(f"{value:.6g}")
