"""The cloth simulation filter (Zhang et al. 2016), as its authors publish it: package ``cloth-simulation-filter``.

The points are turned upside down and a cloth falls on them; what lies close to it is ground. The filter works in
processes of its own, for three reasons, all of them measured. With more than one thread it gives other marks each time,
and how many it takes is read from the environment once, where its library is loaded; so the environment is made for it.
It writes to standard output, where the summary of a run belongs. And it holds the interpreter's lock.
"""

import importlib.util
import os
import signal
import subprocess
import sys
import threading
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CsfSettings, UsageError
from bumpymap.patches.ground._cloth_child import REQUEST
from bumpytiles import BLOCK_TILES, Grid, TilePoints

__all__ = ["close_filter", "filter_version", "mark_ground", "require_filter"]

_PACKAGE = "cloth-simulation-filter"
_MOST_MESHES = 500
"""Meshes of the cloth along a side of a block: a quarter of a million take 100 MB."""
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OMP_THREAD_LIMIT": "1", "OPENBLAS_NUM_THREADS": "1"}

_Child = subprocess.Popen[bytes]
_LOCK = threading.Lock()
_IDLE: list[_Child] = []
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
    # From the block's own corner: the filter must not meet coordinates of millions of metres.
    columns = points.easting - west, points.northing - south, points.upward - points.upward.min()
    request = REQUEST.pack(
        len(points.upward),
        settings.cloth_resolution,
        settings.class_threshold,
        settings.rigidness,
        settings.slope_smooth,
    )
    with _LOCK:
        child = _IDLE.pop() if _IDLE else None
    child = child or _start()
    try:
        answer = _asked(child, [request, *(column.data for column in columns)])
    except BaseException:
        _end(child)
        raise
    with _LOCK:
        _IDLE.append(child)
    return np.frombuffer(answer, np.bool_)


def close_filter() -> None:
    """End the processes of the filter; the next block starts another."""
    with _LOCK:
        idle = _IDLE.copy()
        _IDLE.clear()
    for child in idle:
        _end(child)


def _asked(child: _Child, request: list[bytes | memoryview]) -> bytes:
    points = len(request[-1])
    try:
        for part in request:
            child.stdin.write(part)  # type: ignore[union-attr]
        child.stdin.flush()  # type: ignore[union-attr]
    except BrokenPipeError:
        _mourn(child)
    answer = child.stdout.read(points)  # type: ignore[union-attr]
    if len(answer) < points:
        _mourn(child)
    return answer


def _mourn(child: _Child) -> NoReturn:
    code = child.wait()
    how = f"ended by itself (code {code})" if code >= 0 else f"was ended by {signal.Signals(-code).name}"
    raise UsageError(
        f"the process of the cloth simulation filter {how}. For want of memory: lower `memory` or `threads`. Else see "
        f"whether it is installed as it should be: {sys.executable} -c 'import CSF'"
    )


def _start() -> _Child:
    found = [importlib.util.find_spec(name) for name in ("CSF", "numpy")]
    places = [str(Path(spec.origin).parents[up]) for up, spec in enumerate(found) if spec and spec.origin]
    # Without site-packages as a whole: what people put there is run at every start.
    places.append(str(Path(__file__).parent))
    code = f"import sys; sys.path += {places!r}; import _cloth_child; _cloth_child.serve()"
    try:
        return subprocess.Popen(  # noqa: S603 (this Python, and a script of this package)
            [sys.executable, "-I", "-S", "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **_ONE_THREAD},
            start_new_session=True,  # Ctrl-C is for the parent
        )
    except OSError as error:
        raise UsageError(
            f"cannot start a process for the cloth simulation filter ({error.strerror}). End other programs, and run "
            "again"
        ) from error


def _end(child: _Child) -> None:
    child.kill()  # it keeps nothing
    for pipe in (child.stdin, child.stdout):
        try:
            pipe.close()  # type: ignore[union-attr]
        except BrokenPipeError:
            continue  # what it was sent last is of no use any more
    child.wait()
