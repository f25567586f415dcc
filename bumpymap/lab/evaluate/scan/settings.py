"""Settings of an evaluation of scans."""

from dataclasses import dataclass

from bumpymap.core import UsageError

__all__ = ["ScanEvaluateSettings"]


@dataclass(frozen=True, slots=True)
class ScanEvaluateSettings:
    """All settings that affect the numbers, apart from the scans."""

    scenes: int = 44
    """Number of synthetic scenes if no scans are given; none of them is used in training."""
    seed: int = 7
    """Seed of the scenes and the rotations."""
    turns: int = 8
    """Number of rotations about z of every scan."""
    repeats: int = 50
    """Number of repeats of each measured time; the median is reported."""
    pairs: int = 11
    """Number of synthetic scenes that two sensors see; one of every theme. Not used with scans from files."""

    def __post_init__(self) -> None:
        for name, least in (("scenes", 1), ("seed", 0), ("turns", 1), ("repeats", 3), ("pairs", 1)):
            if getattr(self, name) < least:
                raise UsageError(f"`{name}` is {getattr(self, name)}; it must be {least} or more")
