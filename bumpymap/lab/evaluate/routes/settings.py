"""Settings of an evaluation of routes."""

from dataclasses import dataclass, field

from bumpymap.core import UsageError
from bumpymap.lab.simulate import DriveSettings

__all__ = ["RouteTrialSettings"]


@dataclass(frozen=True, slots=True)
class RouteTrialSettings:
    """All settings that affect the numbers, apart from map and vehicle."""

    total_pairs: int = 20
    """Pairs of a start and a goal."""
    repeats: int = 4
    """Drives along each way, each a little to the left or right of it."""
    seed: int = 7
    least_m: float = 40.0
    """Shortest distance between start and goal, m."""
    most_m: float = 150.0
    """Longest."""
    offset_m: float = 0.1
    """The drives are up to this far beside the way, m: the margin beside the vehicle with which tiles are passable."""
    most_shared: float = 0.8
    """Largest share of the best way's length that may lie in tiles of the straight line; else there is nothing to
    compare."""
    drive: DriveSettings = field(default_factory=DriveSettings)

    def __post_init__(self) -> None:
        for name, value, least in (
            ("pairs", self.total_pairs, 1),
            ("repeats", self.repeats, 1),
            ("seed", self.seed, 0),
        ):
            if value < least:
                raise UsageError(f"`{name}` is {value}; it must be {least} or more")
        if not 0 < self.least_m <= self.most_m:
            raise UsageError(
                f"distances are {self.least_m} to {self.most_m} m; the first must be above 0 and no larger"
            )
        if not 0 <= self.offset_m < self.drive.margin_m:
            raise UsageError(f"offset_m is {self.offset_m}; it must be 0 to {self.drive.margin_m} m")
