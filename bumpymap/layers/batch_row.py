"""One survey of a batch: what became of it, and what its layers say."""

from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

__all__ = ["SurveyRow", "SurveyStatus"]

SurveyStatus: TypeAlias = Literal["done", "already done", "incomplete", "failed", "not reached"]
"""``incomplete``: layers were written, but files were skipped, or too many tiles are unknown."""


def _column(description: str, unit: str = "") -> Any:
    return field(default=None, metadata={"description": description} | ({"unit": unit} if unit else {}))


@dataclass(frozen=True, slots=True)
class SurveyRow:
    """What became of one survey. None: not known, as that of a survey without layers."""

    name: str
    """Folder of its layers."""
    status: SurveyStatus
    message: str = ""
    """Why it failed, or what is incomplete."""
    warnings: tuple[str, ...] = field(
        default=(), metadata={"description": "warnings of the run, in a table separated by ' | '"}
    )
    seconds: float | None = _column("wall time of the run that made the layers, or until it failed", "s")
    survey: str = ""
    """Its files or folder, as the run was given them; a URL without user and query, which may hold a key."""
    points: int | None = _column("points read that are neither withheld nor noise")
    density: float | None = _column("points per area of the tiles with points", "1/m2")
    area: float | None = _column("area of the tiles with points", "m2")
    tiles: int | None = _column("tiles with points")
    share_smooth: float | None = _column("share of the tiles of class 0")
    share_fair: float | None = _column("share of the tiles of class 1")
    share_rough: float | None = _column("share of the tiles of class 2")
    share_very_rough: float | None = _column("share of the tiles of class 3")
    share_passable: float | None = _column("share of the tiles that are passable")
    share_unknown: float | None = _column("share of the tiles without a class")
    unknown_reason: str | None = _column("why most of them have none")
    crs: str | None = _column("code of the CRS, or its name")
    min_x: float | None = _column("west edge of the tiles", "units of the CRS")
    min_y: float | None = _column("south edge of the tiles", "units of the CRS")
    max_x: float | None = _column("east edge of the tiles", "units of the CRS")
    max_y: float | None = _column("north edge of the tiles", "units of the CRS")
    vehicle: str | None = _column("vehicle of the calibration")
    calibration: str | None = _column("id of the calibration")
    checksum: str | None = _column("checksums of the input files, as in run.json, separated by spaces")
