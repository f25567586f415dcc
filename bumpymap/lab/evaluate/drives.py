"""The drives over chosen patches, for comparison with predictions."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PatchStack
from bumpymap.lab.evaluate.settings import EvaluateSettings
from bumpymap.lab.simulate import PatchDrives
from bumpymap.rating import Vehicle

__all__ = ["MOST_FAILED", "DriveStats", "driven_ground", "journal_settings"]

Floats = NDArray[np.float64]
MOST_FAILED = 0.25
"""If a larger share of the drives failed, C_r is not compared, because it comes from the completed drives only."""


@dataclass(frozen=True, slots=True)
class DriveStats:
    """Statistics of the drives over n patches."""

    c_r: Floats
    """(n,) mean C_r over the completed drives, rad/m; NaN if there are none."""
    error: Floats
    """(n,) standard error of that mean, rad/m; NaN with fewer than two."""
    completed: NDArray[np.int64]
    """(n,) number of completed drives."""
    failed: NDArray[np.int64]
    """(n,) number of failed drives."""

    @classmethod
    def of(cls, drives: Sequence[PatchDrives]) -> "DriveStats":
        """Summarise the drives of each patch."""
        return cls(
            np.array([_number(patch.mean_c_r) for patch in drives]),
            np.array([_number(patch.standard_error) for patch in drives]),
            np.array([len(patch.completed) for patch in drives], np.int64),
            np.array([patch.failed for patch in drives], np.int64),
        )

    @property
    def failed_share(self) -> Floats:
        """(n,) share of failed drives, 0..1."""
        share: Floats = self.failed / (self.failed + self.completed)
        return share

    @property
    def comparable(self) -> NDArray[np.bool_]:
        """(n,) True if enough drives were completed to compare C_r."""
        good: NDArray[np.bool_] = (self.failed_share <= MOST_FAILED) & (self.c_r > 0)
        return good

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> "DriveStats":
        """Select patches."""
        return DriveStats(*(getattr(self, f.name)[rows] for f in fields(self)))


def driven_ground(patches: PatchStack) -> Floats:
    """Return the ground to drive over: the relief of each patch, holes filled, on its plane; (n, pixels, pixels), m.

    The plane is the difference between the heights and the relief; its mean height is irrelevant and left out.
    """
    px = patches.grid.pixels
    axis = np.arange(px) - (px - 1) / 2
    east, south = np.meshgrid(axis, axis)
    terms = np.stack([np.ones(px * px), east.ravel(), south.ravel()], axis=1)
    ground = np.empty(patches.relief_map.shape)
    for tile, (relief, heights) in enumerate(zip(patches.relief_map, patches.heights, strict=True)):
        plane = (heights.astype(np.float64) - relief).ravel()
        known = np.isfinite(plane)
        (_, to_east, to_south), *_ = np.linalg.lstsq(terms[known], plane[known], rcond=None)
        ground[tile] = relief + to_east * east + to_south * south
    return ground


def journal_settings(
    profile: Vehicle, settings: EvaluateSettings, tile_size: float, pixels: int, ground: dict[str, Any]
) -> dict[str, Any]:
    """Return everything that affects the drives of a patch, as JSON. The choice and rating of patches do not."""
    return {
        "vehicle": profile.to_dict(),
        "effort": asdict(settings.effort),
        "seed": settings.seed,
        "drive": asdict(settings.drive),
        "tile_size": tile_size,
        "pixels": pixels,
        "ground": ground,
        "versions": {name: version(name) for name in ("dartpy", "numpy")},
    }


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
