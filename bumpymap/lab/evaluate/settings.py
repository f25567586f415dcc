"""Settings of an evaluation."""

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

from bumpymap.core import FeatureSettings, Rating, UsageError
from bumpymap.lab.simulate import DriveSettings, Effort

__all__ = ["EvaluateSettings", "Part"]

Part = Literal["drives", "density", "invariance", "noise", "timing"]
"""Parts of an evaluation that can be skipped."""


@dataclass(frozen=True, slots=True)
class EvaluateSettings:
    """All settings that affect the numbers, apart from survey and vehicles."""

    total_patches: int = 300
    """Number of patches to drive over."""
    min_starts: int = 16
    """Minimum number of drives per patch."""
    max_starts: int = 48
    """Maximum number of drives per patch; they stop once the standard error of the mean C_r is below 5 % of it."""
    seed: int = 7
    rating: Rating = "ride"
    """Rating of `map`; ``ride`` evaluates both ratings, ``table`` only the table."""
    densities: tuple[float, ...] = (100.0, 50.0, 20.0, 10.0, 5.0)
    """Densities to which the survey is thinned, points per m2."""
    skip: frozenset[Part] = frozenset()
    drive: DriveSettings = field(default_factory=DriveSettings)
    features: FeatureSettings = field(default_factory=FeatureSettings)

    def __post_init__(self) -> None:
        for name, least in (("total_patches", 10), ("min_starts", 2), ("seed", 0)):
            if getattr(self, name) < least:
                raise UsageError(f"`{name}` is {getattr(self, name)}; it must be {least} or more")
        if self.min_starts > self.max_starts:
            raise UsageError(
                f"`min_starts` is {self.min_starts}, more than `max_starts`, which is {self.max_starts}: give fewer, "
                "or raise `max_starts`"
            )
        if not all(math.isfinite(density) and density > 0 for density in self.densities):
            raise UsageError(f"`densities` are {self.densities}; they must be positive numbers of points per m2")
        unknown = sorted(set(self.skip) - set(get_args(Part)))
        if unknown:
            raise UsageError(f"--skip {','.join(unknown)}; what can be left out: {', '.join(get_args(Part))}")

    @property
    def effort(self) -> Effort:
        """Bounds on the number of drives per patch."""
        return Effort(self.min_starts, self.max_starts)
