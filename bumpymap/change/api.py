"""Changes from Python: from the layers of two surveys to what differs, in one call."""

import os
from pathlib import Path
from typing import TypeAlias

from bumpymap.change.pipeline import ChangeResult, find_changes
from bumpymap.change.settings import DiffConfig
from bumpymap.layers import Layers

__all__ = ["diff_surveys"]

PathLike: TypeAlias = str | os.PathLike[str]


def diff_surveys(
    before: "PathLike | Layers",
    after: "PathLike | Layers",
    out: PathLike | None = None,
    *,
    fdr: float = 0.05,
    min_tiles: int = 2,
    offset: float | None = None,
    overwrite: bool = False,
) -> ChangeResult:
    """Find what has changed between two surveys of a site, as ``bumpymap diff`` does.

    Parameters
    ----------
    before, after : path or Layers
        What `map_survey` or ``bumpymap map`` wrote of the earlier and of the later survey.
    out : path, optional
        Folder for change.tif, change.geojson, change.json, their style and page; without it nothing is written.
    fdr : float
        Share of the changed tiles that may be found by mistake, on average.
    min_tiles : int
        Fewest connected tiles of a change; smaller ones are left out.
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
    first, second = (site.folder if isinstance(site, Layers) else Path(site) for site in (before, after))
    target = None if out is None else Path(out)
    return find_changes(DiffConfig(first, second, target, fdr, min_tiles, offset, overwrite))
