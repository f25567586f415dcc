"""Drive over one patch from many starts, until the maximum count or the target error of the mean C_r is reached."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import UsageError
from bumpymap.lab.simulate.drive import DriveSettings, Outcome, drive
from bumpymap.lab.simulate.terrain import PatchGround
from bumpymap.rating import Vehicle

__all__ = ["Effort", "PatchDrives", "drive_patch", "start_seed"]


@dataclass(frozen=True, slots=True)
class Effort:
    """Bounds on the number of drives per patch."""

    least: int = 16
    most: int = 64
    target_error: float = 0.05
    """Drives stop once the standard error of the mean C_r is below this share of it."""

    def __post_init__(self) -> None:
        if not 1 <= self.least <= self.most:
            raise UsageError(
                f"{self.least} to {self.most} drives per patch; the first must be at least 1, the second not smaller"
            )
        if not self.target_error > 0:
            raise UsageError(f"target error is {self.target_error}; it must be above 0, such as 0.05")

    @classmethod
    def fixed(cls, starts: int) -> "Effort":
        """Return an effort of exactly this many drives."""
        return cls(starts, starts)


@dataclass(frozen=True, slots=True)
class PatchDrives:
    """Results of the drives over one patch, in the order of the starts."""

    outcome: tuple[Outcome, ...]
    c_r: tuple[float | None, ...]
    """rad/m; None unless completed."""

    @property
    def completed(self) -> list[float]:
        """C_r of the completed drives, rad/m."""
        return [value for value in self.c_r if value is not None]

    @property
    def mean_c_r(self) -> float | None:
        """Mean C_r of the completed drives, rad/m; None if there are none."""
        completed = self.completed
        return math.fsum(completed) / len(completed) if completed else None

    @property
    def standard_error(self) -> float | None:
        """Standard error of the mean, rad/m; None with fewer than two completed drives."""
        completed = self.completed
        if len(completed) < 2:
            return None
        return float(np.std(completed, ddof=1)) / math.sqrt(len(completed))

    @property
    def failed(self) -> int:
        """Number of drives that rolled over or got stuck."""
        return sum(outcome != "completed" for outcome in self.outcome)


def drive_patch(
    profile: Vehicle,
    heights: NDArray[np.floating],
    tile_size: float,
    seed: int,
    effort: Effort | None = None,
    settings: DriveSettings | None = None,
    *,
    stream: tuple[int, ...] = (),
) -> PatchDrives:
    """Drive over one patch from random starts at random headings.

    Every start has its own random stream, so more drives never change earlier ones. The result depends on the
    arguments only and is the same in any process.

    Parameters
    ----------
    profile : Vehicle
    heights : array (pixels, pixels)
        m, north row first, without NaN.
    tile_size : float
        Side of the patch, m.
    seed : int
    effort : Effort, optional
    settings : DriveSettings, optional
    stream : tuple of int
        Distinguishes patches that share a seed.

    Returns
    -------
    PatchDrives
        If none of the first ``least`` drives is completed, no further drives are made: there is no C_r to refine.
    """
    effort = effort or Effort()
    ground = PatchGround.from_heights(heights.astype(np.float64), tile_size)
    drives = PatchDrives((), ())
    while len(drives.outcome) < effort.most and not _is_enough(drives, effort):
        made = drive(profile, ground, start_seed(seed, (*stream, len(drives.outcome))), settings)
        c_r = made.c_r if made.outcome == "completed" else None
        drives = PatchDrives((*drives.outcome, made.outcome), (*drives.c_r, c_r))
    return drives


def _is_enough(drives: PatchDrives, effort: Effort) -> bool:
    """Return whether no further drives are needed."""
    if len(drives.outcome) < effort.least:
        return False
    mean, error = drives.mean_c_r, drives.standard_error
    return mean is None or (error is not None and error <= effort.target_error * mean)


def start_seed(seed: int, stream: tuple[int, ...]) -> int:
    """Return the seed of one drive from that of all and the numbers of its own random stream."""
    return int(np.random.SeedSequence(seed, spawn_key=stream).generate_state(1, np.uint64)[0])
