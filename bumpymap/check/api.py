"""Checks of a map from Python: from logs of drives to how well the map agrees with them, in one call."""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypeAlias, TypedDict, Unpack

from bumpymap.check.pipeline import run_check
from bumpymap.check.settings import CheckConfig
from bumpymap.core import CheckResult, UsageError, path_of_call, refuse_unknown, settings_of_call, short_repr
from bumpymap.layers import Layers, folder_of

__all__ = ["check_drives"]

PathLike: TypeAlias = str | os.PathLike[str]


class CheckSettings(TypedDict, total=False):
    """Settings of `check_drives`: fields of ``CheckConfig``."""

    columns: Mapping[str, str] | None
    band_hz: float
    window_m: float
    overwrite: bool


def check_drives(
    layers: "PathLike | Layers | None",
    drives: PathLike | Iterable[PathLike],
    out: PathLike | None = None,
    **settings: Unpack[CheckSettings],
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
        Rates are low-passed at this frequency, Hz; default 10.
    window_m : float
        Length of a stretch, at least 5 m; default 10.
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
    refuse_unknown(settings, CheckSettings.__annotations__, "check_drives")
    columns = settings.pop("columns", None)
    if columns is not None and not (
        isinstance(columns, Mapping) and all(isinstance(text, str) for entry in columns.items() for text in entry)
    ):
        raise UsageError(f"columns is {short_repr(columns)}; give a dict, such as {{'rate_y': 'GyrY[deg/s]'}}")
    own = settings_of_call(settings, CheckConfig, "check_drives")
    each = [drives] if isinstance(drives, str | os.PathLike) else drives
    if not isinstance(each, Iterable):
        raise UsageError(f"drives is {short_repr(drives)}; give the log of a drive, or a list of logs")
    named = tuple(path_of_call("drives", drive) for drive in each)
    site = None if layers is None else folder_of("layers", layers)
    target = None if out is None else Path(path_of_call("out", out))
    return run_check(CheckConfig(named, site, target, columns, **own)).result
