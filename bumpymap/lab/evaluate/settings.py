"""What an evaluation does, and how much of it."""

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

from bumpymap.core import FeatureSettings, Rating, UsageError
from bumpymap.lab.simulate import DriveSettings, Effort

__all__ = ["EvaluateSettings", "Part"]

Part = Literal["drives", "density", "invariance", "noise", "timing"]
"""What can be left out."""


@dataclass(frozen=True, slots=True)
class EvaluateSettings:
    """Everything beside the survey and the vehicles that decides the numbers."""

    total_patches: int = 300
    """Patches to drive over."""
    min_starts: int = 16
    """Drives over one patch, at least."""
    max_starts: int = 48
    """More drives follow until the standard error of the mean C_r is below 5 % of it, or there are so many."""
    seed: int = 7
    rating: Rating = "ride"
    """As `map` rates; ``table`` alone leaves the ride model out, which it stands beside else."""
    densities: tuple[float, ...] = (100.0, 50.0, 20.0, 10.0, 5.0)
    """Points per m2 that the survey is thinned to."""
    skip: frozenset[Part] = frozenset()
    drive: DriveSettings = field(default_factory=DriveSettings)
    features: FeatureSettings = field(default_factory=FeatureSettings)

    def __post_init__(self) -> None:
        for name, least in (("total_patches", 10), ("min_starts", 2), ("seed", 0)):
            if getattr(self, name) < least:
                raise UsageError(f"{name} is {getattr(self, name)}; it must be {least} or more")
        if self.min_starts > self.max_starts:
            raise UsageError(
                f"min_starts is {self.min_starts}, more than max_starts, which is {self.max_starts}: give fewer, or "
                "raise --max-starts"
            )
        if not all(math.isfinite(density) and density > 0 for density in self.densities):
            raise UsageError(f"densities are {self.densities}; they must be positive numbers of points per m2")
        unknown = sorted(set(self.skip) - set(get_args(Part)))
        if unknown:
            raise UsageError(f"--skip {','.join(unknown)}; what can be left out: {', '.join(get_args(Part))}")

    @property
    def effort(self) -> Effort:
        """Drives of one patch."""
        return Effort(self.min_starts, self.max_starts)
