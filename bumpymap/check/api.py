"""Checks of a map from Python: from logs of drives to how well the map agrees with them, in one call."""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypeAlias

from bumpymap.check.pipeline import run_check
from bumpymap.check.settings import CheckConfig
from bumpymap.core import CheckResult
from bumpymap.layers import Layers

__all__ = ["check_drives"]

PathLike: TypeAlias = str | os.PathLike[str]


def check_drives(
    layers: "PathLike | Layers | None",
    drives: PathLike | Iterable[PathLike],
    out: PathLike | None = None,
    *,
    columns: Mapping[str, str] | None = None,
    band_hz: float = 10.0,
    window_m: float = 10.0,
    overwrite: bool = False,
) -> CheckResult:
    """Hold a map against real drives over it, as ``bumpymap check`` does.

    Parameters
    ----------
    layers : path, Layers or None
        What `map_survey` or ``bumpymap map`` wrote; None measures the drives alone.
    drives : path, or several
        Each a log (CSV, a bag of ROS, ULog), or the files of one drive joined by commas.
    out : path, optional
        Folder for the page, the picture, tables and GIS layers; without it nothing is written.
    columns : mapping, optional
        Quantity -> column or topic that holds it, such as ``{"rate_y": "GyrY[deg/s]"}``; by default they are guessed.
    band_hz : float
        Rates are low-passed at this frequency, Hz.
    window_m : float
        Length of a stretch, at least 5 m.
    overwrite : bool
        Replace the files of an earlier check.

    Returns
    -------
    CheckResult
        ``agreement`` and ``by_class`` say how well they agree, ``drives`` what was found of each drive and its
        sensors, ``stretches`` and ``tiles`` hold what was measured [rad/m] beside what the map says. ``skipped`` names
        the drives that could not be used, with the reason.

    Raises
    ------
    BadInputError
        The layers cannot be read, or no drive can be used.
    UsageError
        A setting is wrong.
    OutputError
        The files cannot be written.

    Examples
    --------
    >>> import bumpymap
    >>> result = bumpymap.check_drives("site_layers", "drive.csv")
    >>> result.agreement.stretches == len(result.stretches.measured)
    True
    """
    each = [drives] if isinstance(drives, str | os.PathLike) else drives
    site = layers.folder if isinstance(layers, Layers) else _path(layers)
    named = tuple(os.fspath(drive) for drive in each)
    return run_check(CheckConfig(named, site, _path(out), columns, band_hz, window_m, overwrite)).result


def _path(given: PathLike | None) -> Path | None:
    return None if given is None else Path(given)
