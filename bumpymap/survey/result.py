"""The result of a run of the main job."""

from dataclasses import dataclass
from pathlib import Path

from bumpymap.layers import MapSummary
from bumpymap.survey.flight_lines import FlightLines

__all__ = ["MapResult"]


@dataclass(frozen=True, slots=True)
class MapResult:
    """What a run wrote and found."""

    files: tuple[Path, ...]
    """Files written, in the order of writing."""
    summary: MapSummary
    """Statistics of the rated tiles."""
    points: int
    """Points read that are neither withheld nor noise; duplicates are included."""
    ground_only: bool
    """Only ground was measured: points of class 2, or those that the cloth filter found (``ground = "csf"``)."""
    skipped: dict[str, str]
    """Inputs that could not be read, with the error message (``skip_bad``)."""
    seconds: dict[str, float]
    """Wall time by stage."""
    lines: FlightLines
    """Steps between flight lines, and what was taken off."""
    rates_thin: bool
    """Thin tiles were rated from their points."""
    sheets: int = 0
    """Sheets that the layers are written in; 0: one map."""
    already_done: bool = False
    """An earlier run with the same inputs and settings is complete: nothing was written, and these are its results."""
