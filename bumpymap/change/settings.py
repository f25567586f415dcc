"""Settings of a comparison of two surveys: declared once, checked when they are created."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from bumpymap.core import Setting, check_settings


@dataclass(frozen=True, slots=True)
class DiffConfig:
    """All settings of a ``diff`` run."""

    before: Path
    """Layers of the earlier survey."""
    after: Path
    """Layers of the later one."""
    out: Annotated[Path | None, Setting("Folder for the files: raster, places, page", "DIR", group="Output")] = None
    """Folder for the files; None: only the summary."""
    fdr: Annotated[
        float, Setting("Share of changed tiles found by mistake", "SHARE", 0.0, 1.0, exclusive=True, rare=True)
    ] = 0.05
    min_tiles: Annotated[int, Setting("Fewest connected tiles of a change", "N", 1, rare=True)] = 2
    """Fewest connected tiles of a change; smaller ones are left out."""
    offset: Annotated[
        float | None, Setting("Height to take off AFTER", "M", unit="m", default="as measured", rare=True)
    ] = None
    """Height that is taken off the later survey, m; None: the median difference, as measured, and a tilt before it."""
    register: Annotated[bool, Setting("Find a shift and a tilt of AFTER and take them off", rare=True)] = True
    overwrite: Annotated[bool, Setting("Replace the files of an earlier run", group="Output")] = False

    def __post_init__(self) -> None:
        check_settings(self)
