"""Views of the layers of a map, in its folder: styles, a project and a page."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bumpymap.views.gis.project import write_project
from bumpymap.views.gis.styles import write_styles
from bumpymap.views.page.map_page import write_report

__all__ = ["write_map_views"]


def write_map_views(folder: Path, record: Mapping[str, Any]) -> None:
    """Write the styles, map.qgs and report.html of the layers in a folder.

    Parameters
    ----------
    folder : Path
        The layers of a run, or the virtual rasters over those of its sheets.
    record : mapping
        The content of run.json, which need not be there yet.

    Raises
    ------
    BadInputError
        A layer cannot be read.
    OutputError
        A file cannot be written.
    """
    write_styles(folder, record)
    write_project(folder, record)
    write_report(folder, record)
