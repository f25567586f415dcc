"""What every reader takes and gives: options, what a header says, chunks of points."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from bumpymap.config import ZUnit
from bumpymap.types import Georeference, PointCloud
from bumpytiles import Bounds

__all__ = ["DROPPED", "ReadOptions", "SurveyInfo", "SurveyReader"]

DROPPED = ("withheld", "noise", "not_a_number")
"""Keys of ``SurveyReader.dropped``: flagged withheld; class 7 or 18; PCD rows that stand for "no return"."""


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What the user says about the files; it wins over what the files say."""

    crs: str | None = None
    """Anything PROJ understands, such as ``EPSG:32614``; None: believe the file."""
    z_unit: ZUnit | None = None
    """Unit of the heights; None: believe the file."""
    trust_points: bool = False
    """Ignore the extent that a header claims; the points' own counts."""


@dataclass(frozen=True, slots=True)
class SurveyInfo:
    """What is known of a file before its points are read."""

    path: Path
    format: str
    """Such as ``LAS 1.2, point format 3``."""
    size_bytes: int
    point_count: int
    """Promised by the header."""
    georeference: Georeference
    bounds: Bounds | None
    """What the header claims, m; None where the format has no such header, or it is not to be believed."""
    has_classes: bool | None
    """Whether points carry a class; None: the format has the field, only the points tell whether it is used."""
    notes: tuple[str, ...]
    """What a user should know, one sentence each."""


class SurveyReader(Protocol):
    """One point cloud file, read in chunks; each call of ``chunks`` starts at the first point."""

    @property
    def info(self) -> SurveyInfo:
        """What the header says."""

    @property
    def dropped(self) -> dict[str, int]:
        """How many points did not count, by reason; complete once ``chunks`` is used up."""

    def chunks(self, points: int = 1_000_000) -> Iterator[PointCloud]:
        """Give the points that count, in metres, in the file's order, at most ``points`` at a time.

        Raises
        ------
        BadInputError
            The file is damaged, or its header and its points disagree. What concerns all points (how many there are,
            where they lie) is known, and raised, at the end.
        """
