"""Settings of a check of a map against real drives: declared once, checked when they are created."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from bumpymap.core import Setting, UsageError, check_settings

LEAST_WINDOW_M = 5.0
"""Shortest stretch that gets a C_r of its own, m (chosen: of less it is chance)."""


@dataclass(frozen=True, slots=True)
class CheckConfig:
    """All settings of a ``check`` run."""

    drives: Annotated[
        tuple[str, ...],
        Setting("Log: CSV, bag, ULog; files of one drive by commas", "LOG", option="drive", group="Input"),
    ]
    layers: Path | None = None
    """Layers of the map; None: the drives are measured alone."""
    out: Annotated[Path | None, Setting("Folder for the files: page, tables, GIS layers", "DIR", group="Output")] = None
    """Folder for the files; None: only the summary."""
    columns: Mapping[str, str] | None = None
    """Quantity -> column or topic that holds it; None: by their names."""
    band_hz: Annotated[
        float, Setting("Rates are low-passed at this frequency", "HZ", 1.0, unit="Hz", option="band", rare=True)
    ] = 10.0
    window_m: Annotated[
        float,
        Setting(
            "Length of a stretch, at least 5",
            "M",
            LEAST_WINDOW_M,
            unit="m",
            why=", so that the C_r of a stretch is more than chance",
            option="window",
            rare=True,
        ),
    ] = 10.0
    calibration: Annotated[
        Path | None, Setting("That of the map, if it is not included; what --refit moves", "FILE", group="Vehicle")
    ] = None
    """The calibration that the map was made with; None: an included one."""
    overwrite: Annotated[bool, Setting("Replace the files of an earlier check", group="Output")] = False

    def __post_init__(self) -> None:
        check_settings(self)
        if not self.drives:
            raise UsageError("no drive is given. Give the log of a drive with `drives`, such as a CSV file or a bag")
        twice = [drive for number, drive in enumerate(self.drives) if drive in self.drives[:number]]
        if twice:
            raise UsageError(f"the drive {twice[0]} is given twice, and would count twice. Give each once")
