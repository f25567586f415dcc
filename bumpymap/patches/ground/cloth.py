"""The cloth simulation filter (Zhang et al. 2016), as its authors publish it: package ``cloth-simulation-filter``.

The points are turned upside down and a cloth falls on them; what lies close to it is ground. The filter works in
processes of its own, for three reasons, all of them measured. With more than one thread it gives other marks each time,
and how many it takes is read from the environment once, where its library is loaded; so the environment is made for it.
It writes to standard output, where the summary of a run belongs. And it holds the interpreter's lock.
"""

import importlib.util
import os
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Child, ChildDiedError, CsfSettings, UsageError, folder_of, free_memory, take_memory
from bumpytiles import BLOCK_TILES, Grid, TilePoints

__all__ = ["close_filter", "filter_version", "mark_ground", "require_filter"]

_PACKAGE = "cloth-simulation-filter"
_MOST_MESHES = 500
"""Meshes of the cloth along a side of a block: a quarter of a million take 100 MB."""
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OMP_THREAD_LIMIT": "1", "OPENBLAS_NUM_THREADS": "1"}

idle: list[Child] = []
"""Processes that wait for the next block; each thread that works takes one."""


def filter_version() -> dict[str, str]:
    """Give the version of the filter by its name; nothing where it is not installed."""
    try:
        return {_PACKAGE: version(_PACKAGE)}
    except PackageNotFoundError:
        return {}


def require_filter(settings: CsfSettings, grid: Grid) -> None:
    """Check that the filter is there, and that its cloth can cover a block.

    Raises
    ------
    UsageError
        It is not installed, or the meshes of the cloth are too small for such tiles.
    """
    if importlib.util.find_spec("CSF") is None:
        raise UsageError(
            "`ground='csf'` needs the cloth simulation filter (cloth-simulation-filter), which is not installed. "
            "Install it: pip install 'bumpymap[csf]'"
        )
    side = grid.tile_size * BLOCK_TILES
    if side > _MOST_MESHES * settings.cloth_resolution:
        raise UsageError(
            f"cloth_resolution is {settings.cloth_resolution:g} m; for tiles of {grid.tile_size:g} m, whose blocks are "
            f"{side:g} m wide, it must be at least {side / _MOST_MESHES:g} m. Raise cloth_resolution in [csf]"
        )


def mark_ground(points: TilePoints, settings: CsfSettings) -> NDArray[np.bool_]:
    """Tell which points of a whole block are ground.

    Parameters
    ----------
    points : TilePoints
        All points of one block, (n,), in their canonical order.
    settings : CsfSettings

    Returns
    -------
    bool (n,)

    Raises
    ------
    UsageError
        The filter's process cannot be started, or died.
    """
    side = points.grid.tile_size * BLOCK_TILES
    west, south = (int(tiles[0]) // BLOCK_TILES * side for tiles in (points.col, points.row))
    count = len(points.upward)
    coordinates, marks = take_memory(24 * count), take_memory(count)
    # From the block's own corner: the filter must not meet coordinates of millions of metres.
    columns = points.easting - west, points.northing - south, points.upward - points.upward.min()
    np.stack(columns, axis=1, out=coordinates.data.view(np.float64).reshape(count, 3))
    try:
        child = idle.pop()
    except IndexError:
        child = _start()
    try:
        child.ask(
            "mark_ground",
            settings.cloth_resolution,
            settings.class_threshold,
            settings.rigidness,
            settings.slope_smooth,
            shared=(coordinates, marks),
        )
    except ChildDiedError as error:
        child.close()
        raise UsageError(
            f"the process of the cloth simulation filter {error}. For want of memory: lower `memory` or `threads`. "
            f"Else see whether it is installed as it should be: {sys.executable} -c 'import CSF'"
        ) from error
    except BaseException:
        child.close()
        raise
    idle.append(child)
    return marks.data.view(np.bool_)


def close_filter() -> None:
    """End the processes of the filter; the next block starts another."""
    while idle:
        idle.pop().close()
    free_memory()


def _start() -> Child:
    # Without site-packages as a whole: what people put there is run at every start.
    folders = [folder_of("CSF"), folder_of("numpy"), str(Path(__file__).parent)]
    return Child("for the cloth simulation filter", "_cloth_child", folders, _ONE_THREAD)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=idle.clear)
