"""Mark ground points with the cloth simulation filter (Zhang et al. 2016), package ``cloth-simulation-filter``.

The filter turns the points upside down and drops a simulated cloth on them; points close to the cloth are ground. It
runs in child processes for three reasons, all observed. With more than one thread its result differs from run to run,
and it reads the number of threads from the environment once, when its library is loaded, so a child gets its own
environment. It prints to standard output, which is reserved for the summary of a run. And it does not release the
global interpreter lock.
"""

import importlib.util
import os
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    Child,
    ChildDiedError,
    CsfSettings,
    UsageError,
    allocate_shared,
    install_command,
    module_folder,
    trim_shared,
)
from bumpytiles import BLOCK_TILES, PER_METRE, Grid, TilePoints

_PACKAGE = "cloth-simulation-filter"
_MAX_CLOTH_CELLS = 500
"""Most cells of the cloth along a side of a block: a quarter of a million cells take 100 MB."""
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OMP_THREAD_LIMIT": "1", "OPENBLAS_NUM_THREADS": "1"}

idle: list[Child] = []
"""Child processes that are ready for the next block; each worker thread takes one."""


def filter_version() -> dict[str, str]:
    """Return the name and version of the filter's package; empty if it is not installed."""
    try:
        return {_PACKAGE: version(_PACKAGE)}
    except PackageNotFoundError:
        return {}


def require_filter(settings: CsfSettings, grid: Grid) -> None:
    """Raise UsageError if the filter is not installed, or its ``cloth_resolution`` too small for tiles of this size."""
    if importlib.util.find_spec("CSF") is None:
        raise UsageError(
            "`ground='csf'` needs the cloth simulation filter (cloth-simulation-filter), which is not installed. "
            f"Install it: {install_command('csf')}"
        )
    side = grid.tile_size * BLOCK_TILES
    if side > _MAX_CLOTH_CELLS * settings.cloth_resolution:
        raise UsageError(
            f"cloth_resolution is {settings.cloth_resolution:g} m; for tiles of {grid.tile_size:g} m, whose blocks are "
            f"{side:g} m wide, it must be at least {side / _MAX_CLOTH_CELLS:g} m. Raise cloth_resolution in [csf]"
        )


def mark_ground(points: TilePoints, settings: CsfSettings) -> NDArray[np.bool_]:
    """Mark the ground points of a block, (n,): of all its n points, in canonical order.

    Raises UsageError if the child process cannot be started, or died.
    """
    side = points.grid.tile_size * BLOCK_TILES
    west, south = (int(tiles[0]) // BLOCK_TILES * side for tiles in (points.col, points.row))
    count = len(points.upward)
    coordinates, marks = allocate_shared(24 * count), allocate_shared(count)
    # From the block's corner: the filter loses precision with coordinates of millions of metres. By whole steps: points
    # on the border of two cells of the cloth are in the same one wherever the block is.
    columns = points.easting - west, points.northing - south, points.upward - points.upward.min()
    place = coordinates.data.view(np.float64).reshape(count, 3)
    np.stack(columns, axis=1, out=place)
    place *= PER_METRE
    np.rint(place, out=place)
    place /= PER_METRE
    try:
        child = idle.pop()
    except IndexError:
        child = _start()
    try:
        child.call(
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
            f"the process of the cloth simulation filter {error}. If memory ran out, lower `memory` or `threads`; "
            f"otherwise check that the filter can be imported: {sys.executable} -c 'import CSF'"
        ) from error
    except BaseException:
        child.close()
        raise
    idle.append(child)
    return marks.data.view(np.bool_)


def close_filter() -> None:
    """Stop the child processes of the filter; the next block starts a new one."""
    while idle:
        idle.pop().close()
    trim_shared()


def _start() -> Child:
    # Only these folders, not all of site-packages: .pth files there run code at every start.
    folders = [module_folder("CSF"), module_folder("numpy"), str(Path(__file__).parent)]
    return Child("for the cloth simulation filter", "_cloth_child", folders, _ONE_THREAD)


os.register_at_fork(after_in_child=idle.clear)
