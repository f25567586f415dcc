"""Changes from Python: from the layers of two surveys to what differs, in one call."""

import os
from pathlib import Path
from typing import TypeAlias, TypedDict, Unpack

from bumpymap.change.pipeline import ChangeResult, find_changes
from bumpymap.change.settings import DiffConfig
from bumpymap.core import path_of_call, settings_of_call
from bumpymap.layers import Layers, folder_of

__all__ = ["diff_surveys"]

PathLike: TypeAlias = str | os.PathLike[str]


class DiffSettings(TypedDict, total=False):
    """Settings of `diff_surveys`: fields of ``DiffConfig``."""

    fdr: float
    min_tiles: int
    offset: float | None
    overwrite: bool


def diff_surveys(
    before: "PathLike | Layers",
    after: "PathLike | Layers",
    out: PathLike | None = None,
    **settings: Unpack[DiffSettings],
) -> ChangeResult:
    """Find what has changed between two surveys of a site, as ``bumpymap diff`` does.

    Parameters
    ----------
    before, after : path or Layers
        What `map_survey` or ``bumpymap map`` wrote of the earlier and of the later survey.
    out : path, optional
        Folder for change.tif, change.geojson, change.json, their style and page; without it nothing is written.
    fdr : float
        Share of the changed tiles that may be found by mistake, on average; default 0.05.
    min_tiles : int
        Fewest connected tiles of a change, default 2; smaller ones are left out.
    offset : float, optional
        Height to take off the later survey, m; by default the median difference.
    overwrite : bool
        Replace the files of an earlier comparison.

    Returns
    -------
    ChangeResult
        ``counts`` and ``transitions`` (tiles), ``fit``, ``notes``, ``folder``, ``files``; ``regions()`` is a table of
        the places that have changed.

    Raises
    ------
    BadInputError
        The layers cannot be read, cannot be compared, or have no tile in common.
    UsageError
        A setting is wrong.
    OutputError
        The files cannot be written.

    Examples
    --------
    >>> import bumpymap
    >>> change = bumpymap.diff_surveys("site_layers", "site_layers")
    >>> change.counts["changed"], len(change.regions())
    (0, 0)
    """
    own = settings_of_call(settings, DiffConfig, "diff_surveys", DiffSettings.__annotations__)
    target = None if out is None else Path(path_of_call("out", out))
    return find_changes(DiffConfig(folder_of("before", before), folder_of("after", after), target, **own))
