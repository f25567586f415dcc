"""The time of each point of a scan, in seconds, from columns in s, us or ns."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["TIME_COLUMNS", "point_seconds", "start_of_day_time"]

TIME_COLUMNS = ("t", "time", "timestamp", "offset_time", "time_stamp", "timestamps", "scalar_timestamp", "scalar_time")
"""Names, in lower case, of columns with the time of each point."""
_UNITS_S = (1.0, 1e-6, 1e-9)
"""Seconds, microseconds, nanoseconds."""
_SPAN_S = (0.005, 2.0)
"""Time that a scan takes: a revolution at 5 to 20 Hz and its parts, or several. Within these limits no time fits two
units."""
_EPOCH_S = 1e8
"""Later than this (1973) is a time of day and not one since the sensor was switched on."""


def point_seconds(column: NDArray[Any]) -> NDArray[np.float32] | None:
    """Return the time of each point, s.

    Parameters
    ----------
    column : (n,) array of numbers
        Times in s, us or ns, after the time of the frame or of day; may hold values that are not finite.

    Returns
    -------
    (n,) float32 or None
        After the time of the frame, as in the file; of times of day: after the first of them. None if the unit is not
        clear: a scan takes 5 ms to 2 s. NaN where a time is not finite, or 0 among times of day.
    """
    times, unit = _known(column)
    if unit is None:
        return None
    seconds = times * unit
    if np.nanmax(np.abs(seconds)) > _SPAN_S[1]:
        seconds = np.where(times == 0.0, np.nan, times - _first(times)) * unit
    return seconds.astype(np.float32)


def start_of_day_time(column: NDArray[Any]) -> float | None:
    """Return the first time of a column in seconds since 1970; None if it does not hold such times."""
    times, unit = _known(column)
    first = 0.0 if unit is None else _first(times) * unit
    return first if first > _EPOCH_S else None


def _known(column: NDArray[Any]) -> tuple[NDArray[np.float64], float | None]:
    """Return the times, NaN where they are not finite, and their unit in seconds."""
    times = column.astype(np.float64)
    times[~np.isfinite(times)] = np.nan
    stamped = times[~np.isnan(times) & (times != 0.0)]
    span = float(np.ptp(stamped)) if len(stamped) else 0.0
    return times, next((unit for unit in _UNITS_S if _SPAN_S[0] <= span * unit <= _SPAN_S[1]), None)


def _first(times: NDArray[np.float64]) -> float:
    """Return the first time; some drivers write 0 for beams without return."""
    return float(np.nanmin(np.where(times == 0.0, np.nan, times)))
