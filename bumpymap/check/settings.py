"""Settings of a check of a map against real drives: declared once, checked when they are created."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from bumpymap.core import Setting, UsageError, check_settings

__all__ = ["LEAST_WINDOW_M", "CheckConfig", "ReadingSettings"]

LEAST_WINDOW_M = 5.0
"""Shortest stretch that gets a C_r of its own, m."""

BandHz = Annotated[float, Setting("Rates are low-passed at this frequency", "HZ", 1.0, unit="Hz", option="band")]
WindowM = Annotated[
    float,
    Setting(
        "Length of a stretch, at least 5",
        "M",
        LEAST_WINDOW_M,
        unit="m",
        why=", so that the C_r of a stretch is more than chance",
        option="window",
    ),
]


@dataclass(frozen=True, slots=True)
class ReadingSettings:
    """Settings by which the C_r of a drive is measured."""

    band_hz: BandHz = 10.0
    """Rates are low-passed at this frequency, Hz."""
    window_m: WindowM = 10.0
    """Length of a stretch, m."""
    least_speed_mps: float = 0.1
    """Slower parts do not count, m/s."""
    turn_radius_m: float = 4.0
    """Parts that turn more sharply do not count, m."""

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class CheckConfig:
    """All settings of a ``check`` run."""

    drives: Annotated[
        tuple[str, ...],
        Setting(
            "Log of a drive: CSV, a bag of ROS, ULog; files of one drive joined by commas. Can be repeated",
            "LOG",
            option="drive",
        ),
    ]
    """Each a file, the folder of a bag, or several files joined by commas."""
    layers: Path | None = None
    """Layers of the map; None: the drives are measured alone."""
    out: Annotated[Path | None, Setting("Folder for the files: page, picture, tables, GIS layers", "DIR")] = None
    """Folder for the files; None: only the summary."""
    columns: Mapping[str, str] | None = None
    """Quantity -> column or topic that holds it; None: guessed."""
    band_hz: BandHz = 10.0
    """Rates are low-passed at this frequency, Hz."""
    window_m: WindowM = 10.0
    """Length of a stretch, m."""
    overwrite: Annotated[bool, Setting("Replace the files of an earlier check")] = False

    def __post_init__(self) -> None:
        check_settings(self)
        if not self.drives:
            raise UsageError("no drive is given. Give the log of a drive with `drives`, such as a CSV file or a bag")
        twice = [drive for number, drive in enumerate(self.drives) if drive in self.drives[:number]]
        if twice:
            raise UsageError(f"the drive {twice[0]} is given twice, and would count twice. Give each once")

    @property
    def measuring(self) -> ReadingSettings:
        """The settings of the measurement alone."""
        return ReadingSettings(band_hz=self.band_hz, window_m=self.window_m)
