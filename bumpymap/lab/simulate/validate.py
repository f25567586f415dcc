"""Drive over the patches of a survey, for comparison with the map."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.simulate.drive import DriveSettings
from bumpymap.lab.simulate.journal import Journal, Key
from bumpymap.lab.simulate.model import require_dart
from bumpymap.lab.simulate.patch import Effort, PatchDrives, drive_patch
from bumpymap.lab.simulate.pool import Progress, drive_jobs
from bumpymap.rating import Vehicle

__all__ = ["DriveConditions", "drive_patches"]


@dataclass(frozen=True, slots=True)
class _PatchJob:
    key: Key
    heights: NDArray[np.floating]
    starts: int


@dataclass(frozen=True, slots=True)
class DriveConditions:
    """Arguments shared by all patches of a trial."""

    profile: Vehicle
    tile_size: float
    """m."""
    seed: int
    effort: Effort = field(default_factory=Effort)
    settings: DriveSettings | None = None
    """As in `drive_patch`."""


def drive_patches(
    conditions: DriveConditions,
    patches: Mapping[Key, NDArray[np.floating]],
    progress: Progress | None = None,
    *,
    workers: int = 1,
    journal: Journal | None = None,
    discard_other: bool = False,
) -> dict[Key, PatchDrives]:
    """Drive over many patches, each until its mean C_r reaches the target error.

    The starts of a patch depend only on the seed and its key, not on other patches or their order.

    Parameters
    ----------
    conditions : DriveConditions
    patches : mapping
        Key, such as (col, row) of a tile -> heights (pixels, pixels), m, north row first, without NaN.
    progress, workers, journal, discard_other
        As in `drive_jobs`; progress counts ``effort.least`` drives per patch. The journal's settings must contain
        everything that affects the numbers, including the survey.

    Returns
    -------
    dict
        Key -> drives.
    """
    require_dart()
    jobs = [_PatchJob(key, heights, conditions.effort.least) for key, heights in patches.items()]
    return drive_jobs(
        partial(drive_job, conditions), jobs, progress, workers=workers, journal=journal, discard_other=discard_other
    )


def drive_job(conditions: DriveConditions, job: _PatchJob) -> PatchDrives:
    """Drive over one patch, as `drive_patch` does."""
    return drive_patch(
        conditions.profile,
        job.heights,
        conditions.tile_size,
        conditions.seed,
        conditions.effort,
        conditions.settings,
        stream=_stream(job.key),
    )


def _stream(key: Key) -> tuple[int, ...]:
    """Hash a key to the numbers of a random stream, which allows neither strings nor negative numbers."""
    digest = hashlib.sha256(json.dumps(key).encode()).digest()
    return tuple(int.from_bytes(digest[at : at + 4], "little") for at in (0, 4, 8))
