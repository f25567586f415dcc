"""Settings of a check of a map against real drives: frozen dataclasses, validated when they are created."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bumpymap.core import UsageError

__all__ = ["LEAST_WINDOW_M", "CheckConfig", "ReadingSettings"]

LEAST_WINDOW_M = 5.0
"""Shortest stretch that gets a C_r of its own, m."""
_LEAST_BAND_HZ = 1.0


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


@dataclass(frozen=True, slots=True)
class ReadingSettings:
    """Settings by which the C_r of a drive is measured."""

    band_hz: float = 10.0
    """Rates are low-passed at this frequency, Hz."""
    window_m: float = 10.0
    """Length of a stretch, m."""
    least_speed_mps: float = 0.1
    """Slower parts do not count, m/s."""
    turn_radius_m: float = 4.0
    """Parts that turn more sharply do not count, m."""

    def __post_init__(self) -> None:
        if not (_is_number(self.band_hz) and self.band_hz >= _LEAST_BAND_HZ):
            raise UsageError(f"`band_hz` is {self.band_hz!r}; it must be a number of at least {_LEAST_BAND_HZ:g} Hz")
        if not (_is_number(self.window_m) and self.window_m >= LEAST_WINDOW_M):
            raise UsageError(
                f"`window_m` is {self.window_m!r}; a stretch must be at least {LEAST_WINDOW_M:g} m long, so that its "
                "C_r is more than chance"
            )


@dataclass(frozen=True, slots=True)
class CheckConfig:
    """All settings of a ``check`` run."""

    drives: tuple[str, ...]
    """Each a file, the folder of a bag, or several files joined by commas."""
    layers: Path | None = None
    """Layers of the map; None: the drives are measured alone."""
    out: Path | None = None
    """Folder for the files; None: only the summary."""
    columns: Mapping[str, str] | None = None
    """Quantity -> column or topic that holds it; None: guessed."""
    band_hz: float = 10.0
    """Rates are low-passed at this frequency, Hz."""
    window_m: float = 10.0
    """Length of a stretch, m."""
    overwrite: bool = False
    """Replace files of an earlier run."""

    def __post_init__(self) -> None:
        if not self.drives:
            raise UsageError("no drive is given. Give the log of a drive with `drives`, such as a CSV file or a bag")
        twice = [drive for number, drive in enumerate(self.drives) if drive in self.drives[:number]]
        if twice:
            raise UsageError(f"the drive {twice[0]} is given twice, and would count twice. Give each once")
        _ = self.measuring  # refuses what is out of range

    @property
    def measuring(self) -> ReadingSettings:
        """The settings of the measurement alone."""
        return ReadingSettings(band_hz=self.band_hz, window_m=self.window_m)
