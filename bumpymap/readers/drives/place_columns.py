"""Positions from the columns of a table: where they are given, what is no position, what is only repeated."""

from collections.abc import Mapping

import numpy as np

from bumpymap.core import PlaceKind, PlaceTrack
from bumpymap.readers.drives.clock import in_order
from bumpymap.readers.drives.column_names import DriveColumn
from bumpymap.readers.drives.guesses import check_lonlat, guess_local
from bumpymap.readers.drives.quantities import EASTING_NORTHING, LOCAL, LONLAT
from bumpymap.readers.drives.signals import Floats

__all__ = ["PLACE_GROUPS", "fresh_places", "read_places"]

PLACE_GROUPS = (LONLAT, EASTING_NORTHING, LOCAL)
_LEAST_FIX = {"fix_type": 2.0, "fix": 1.0, "quality": 1.0, "gps_qual": 1.0}
"""Name -> least value of a position that was measured; 0 for others (``status`` of ROS)."""
_HELD = 0.5
"""From this share of repeated positions on, the table repeats the last one in rows between two positions."""


def read_places(
    source: str, columns: Mapping[str, DriveColumn], values: Mapping[str, Floats], notes: list[str]
) -> PlaceTrack | None:
    """Return the positions of a table: longitude and latitude before eastings and northings, these before odometry.

    Raises
    ------
    BadInputError
        Degrees are out of range, or times are out of order.
    """
    for group in PLACE_GROUPS:
        if set(group) <= set(values):
            found = _track(source, group, (columns, values), notes)
            if found is not None:
                return found
    return None


def _track(
    source: str,
    group: tuple[str, ...],
    table: tuple[Mapping[str, DriveColumn], Mapping[str, Floats]],
    notes: list[str],
) -> PlaceTrack | None:
    columns, values = table
    time, x, y = values["time"], values[group[0]], values[group[1]]
    rows = np.isfinite(time) & np.isfinite(x) & np.isfinite(y)
    bad = np.zeros_like(rows)
    if "fix" in values:
        name = columns["fix"].name.lower()
        bad |= values["fix"] < next((least for key, least in _LEAST_FIX.items() if key in name), 0.0)
    if group == LONLAT:
        bad |= (x == 0.0) & (y == 0.0)
    if lost := int((bad & rows).sum()):
        notes.append(f"{lost:,} positions of {source} were taken without a fix and are left out")
    places = np.flatnonzero(rows & ~bad)
    if not len(places):
        return None
    keep, note = in_order(time[places], f"the positions of {source}")
    notes.extend([note] if note else [])
    places = places[keep]
    error = values["error"][places] if "error" in values else np.full(len(places), np.nan)
    return _settled(source, group, (columns, notes), (time[places], x[places], y[places], error))


def _settled(
    source: str,
    group: tuple[str, ...],
    told: tuple[Mapping[str, DriveColumn], list[str]],
    samples: tuple[Floats, Floats, Floats, Floats],
) -> PlaceTrack:
    columns, notes = told
    time, x, y, error = samples
    kind: PlaceKind = "lonlat" if group == LONLAT else "projected"
    note: str | None = None
    if group == LONLAT:
        x, y, note = check_lonlat(x, y, source, tuple(columns[quantity].name for quantity in group))
    elif group == LOCAL:
        kind, note = guess_local(x, y, source)
    notes.extend([note] if note else [])
    fresh = fresh_places(time, x, y)
    if len(fresh) < len(time):
        notes.append(f"{len(time) - len(fresh):,} positions of {source} only repeat the one before and are left out")
    return PlaceTrack(time[fresh], x[fresh], y[fresh], error[fresh], kind)


def fresh_places(time: Floats, x: Floats, y: Floats) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return which positions were measured, where a table repeats the last one in each row until the next.

    Repetitions stay at the receiver's own interval while the vehicle stands: where the next position is as near as
    positions usually are.

    Parameters
    ----------
    time, x, y : (n,) float64
        s, and positions in any unit.

    Returns
    -------
    (m,) int
        All positions, unless more than half of them repeat the one before.
    """
    count = len(time)
    steps = np.hypot(np.diff(x), np.diff(y))
    changes = np.flatnonzero(np.append(True, steps > 0.0))
    if len(changes) < 3 or (count - len(changes)) <= _HELD * count:
        return np.arange(count)
    interval = float(np.median(np.diff(time[changes])))
    usual = 3.0 * float(np.median(steps[changes[1:] - 1]))
    # A run of equal positions that ends in a usual step is a standstill; one that ends in a long step is a dropout.
    ends = np.append(steps[changes[1:] - 1] <= usual, True)
    run = np.searchsorted(changes, np.arange(count), "right") - 1
    number = np.floor((time - time[changes[run]]) / interval + 1e-6)
    new_interval = np.append(True, np.diff(number) > 0)
    first = np.zeros(count, bool)
    first[changes] = True
    kept: np.ndarray[tuple[int], np.dtype[np.intp]] = np.flatnonzero(first | (ends[run] & new_interval))
    return kept
