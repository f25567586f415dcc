"""Settings of a comparison of two surveys: a frozen dataclass, validated when it is created."""

import math
from dataclasses import dataclass
from pathlib import Path

from bumpymap.core import UsageError

__all__ = ["DiffConfig"]


@dataclass(frozen=True, slots=True)
class DiffConfig:
    """All settings of a ``diff`` run."""

    before: Path
    """Layers of the earlier survey."""
    after: Path
    """Layers of the later one."""
    out: Path | None = None
    """Folder for the files; None: only the summary."""
    fdr: float = 0.05
    """Share of the changed tiles that may be found by mistake."""
    min_tiles: int = 2
    """Fewest connected tiles of a change; smaller ones are left out."""
    offset: float | None = None
    """Height that is taken off the later survey, m; None: the median difference, as measured."""
    overwrite: bool = False
    """Replace files of an earlier run."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.fdr) and 0.0 < self.fdr < 1.0):
            raise UsageError(f"`fdr` is {self.fdr!r}; it must be a number between 0 and 1, such as 0.05")
        if self.min_tiles < 1:
            raise UsageError(f"`min_tiles` is {self.min_tiles!r}; it must be a whole number of at least 1")
        if self.offset is not None and not math.isfinite(self.offset):
            raise UsageError(f"`offset` is {self.offset!r}; it must be a number of metres, such as 0")
