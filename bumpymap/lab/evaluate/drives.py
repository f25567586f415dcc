"""The drives over chosen patches, which predictions are compared with."""

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

__all__ = ["MOST_FAILED", "Driven", "ground_of", "journal_settings"]

Floats = NDArray[np.float64]
MOST_FAILED = 0.25
"""Where more of the drives failed, the mean C_r is that of the survivors: it is not compared."""


@dataclass(frozen=True, slots=True)
class Driven:
    """What the drives over n patches gave."""

    c_r: Floats
    """(n,) mean over the completed drives, rad/m; NaN without one."""
    error: Floats
    """(n,) standard error of that mean, rad/m; NaN with fewer than two."""
    completed: NDArray[np.int64]
    """(n,) drives."""
    failed: NDArray[np.int64]
    """(n,) drives."""

    @classmethod
    def of(cls, drives: Sequence[PatchDrives]) -> "Driven":
        """Sum up the drives of each patch."""
        return cls(
            np.array([_number(patch.mean_c_r) for patch in drives]),
            np.array([_number(patch.standard_error) for patch in drives]),
            np.array([len(patch.completed) for patch in drives], np.int64),
            np.array([patch.failed for patch in drives], np.int64),
        )

    @property
    def failed_share(self) -> Floats:
        """(n,) 0..1."""
        share: Floats = self.failed / (self.failed + self.completed)
        return share

    @property
    def comparable(self) -> NDArray[np.bool_]:
        """(n,) patches whose C_r counts: most of the drives were completed."""
        good: NDArray[np.bool_] = (self.failed_share <= MOST_FAILED) & (self.c_r > 0)
        return good

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> "Driven":
        """Choose patches."""
        return Driven(*(getattr(self, f.name)[rows] for f in fields(self)))


def ground_of(patches: PatchStack) -> Floats:
    """Give the ground that is driven: the relief of each patch, holes filled, on its own plane; (n, pixels, pixels), m.

    The plane is what lies between the heights and the relief; its height in the middle is of no matter and left out.
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
    """All that decides the drives of a patch, as JSON: not which patches are chosen, nor how they are rated."""
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
