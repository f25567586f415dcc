"""How much an evaluation of scans does."""

from dataclasses import dataclass

from bumpymap.core import UsageError

__all__ = ["ScanEvaluateSettings"]


@dataclass(frozen=True, slots=True)
class ScanEvaluateSettings:
    """Everything beside the scans that decides the numbers."""

    scenes: int = 35
    """Made-up scenes, where no scans are given; none of them was learned from."""
    seed: int = 7
    """Of the scenes and the turns."""
    turns: int = 8
    """Turns about z of every scan."""
    repeats: int = 50
    """Of each measured time; the median counts."""

    def __post_init__(self) -> None:
        for name, least in (("scenes", 1), ("seed", 0), ("turns", 1), ("repeats", 3)):
            if getattr(self, name) < least:
                raise UsageError(f"{name} is {getattr(self, name)}; it must be {least} or more")
