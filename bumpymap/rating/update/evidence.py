"""What stretches of drives say about a calibration: the numbers that the update needs, without those that say nothing.

Two stretches beside each other, and two drives over one piece of ground, share the error that the map makes there. So
stretches belong to squares of ground: what is common to a square counts once.
"""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import DrivenStretches

__all__ = ["DriveEvidence", "LeftOut", "collect_evidence"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
SQUARE_M = 30.0
"""Side of a square of ground whose stretches share a part of the map's error."""
SPEED_FACTOR = 1.3
"""Stretches that were driven faster or slower than the calibration by more than this factor do not count."""
MOST_SENSOR_SHARE = 0.5
"""Stretches whose measurement has a larger standard error than this share of what the map says do not count."""
_FOLD_M = 50.0
_FOLDS = 10
_LEAST_DRIVES = 3
_INTERVAL_SD = 2 * 1.2815515655446004
"""Width of an 80 % interval in standard deviations."""
_LEAST_MAP_SD = 0.03
_LEAST_STRETCHES = 8
_TINY = 1e-9
_LEAST_SHARE = 0.1
"""Least part of the map's C_r that is not its floor, and of a standard error that a measurement may be."""


@dataclass(frozen=True, slots=True)
class DriveEvidence:
    """Stretches that count, one row each."""

    log_c_r: Floats
    """(n,) ln of the map's C_r [rad/m], without the floor of the profile."""
    log_measured: Floats
    """(n,) ln of the measured C_r [rad/m]."""
    own_variance: Floats
    """(n,) of ln C_r: errors of the measurement and of the place."""
    map_sd: Floats
    """(n,) of ln C_r, by the map's interval."""
    square: Integers
    """(n,) number of the square of ground, from 0."""
    fold: Integers
    """(n,) number of the part of the drives that is left out together, from 0."""
    drive: Integers
    """(n,) number of the drive."""
    way_m: Floats
    """(n,)"""
    new_m: Floats
    """(n,) length of the stretch, divided by how often its ground was driven."""

    def chosen(self, rows: NDArray[np.bool_]) -> "DriveEvidence":
        """Return some of the rows; squares are numbered again."""
        parts = {each.name: getattr(self, each.name)[rows] for each in fields(self)}
        return DriveEvidence(**parts | {"square": _numbered(parts["square"])})


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Lengths of stretches that do not count, m."""

    off_map: float
    """The map does not know the ground, or nothing was measured."""
    other_speed: float
    below_sensor: float
    """The sensor cannot tell so little motion."""


def collect_evidence(stretches: DrivenStretches, speed_mps: float, floor: float) -> tuple[DriveEvidence, LeftOut]:
    """Return what stretches say, and what does not count.

    Parameters
    ----------
    stretches : DrivenStretches
    speed_mps : float
        Speed that the map's C_r is for.
    floor : float
        C_r of level ground in the profile, which the map's C_r holds in power, rad/m.
    """
    s = stretches
    known = np.isfinite(s.measured) & np.isfinite(s.measured_sd) & np.isfinite(s.easting + s.northing)
    known &= (np.nan_to_num(s.c_r) > 0) & (np.nan_to_num(s.c_r_low) > 0) & np.isfinite(s.c_r_high)
    with np.errstate(all="ignore"):
        fast = known & (np.abs(np.log(s.speed_mps / speed_mps)) > np.log(SPEED_FACTOR))
        factor = np.median(s.measured[known & ~fast] / s.c_r[known & ~fast]) if (known & ~fast).any() else 1.0
    scale = s.c_r * max(float(factor), 1e-3)
    sd = np.where(known, s.measured_sd, np.nan)
    sd[known] = _expected_sd(s.measured[known], sd[known], scale[known])
    low = known & ~fast & (sd > MOST_SENSOR_SHARE * scale)
    rows = known & ~fast & ~low
    way = s.way_m
    lost = LeftOut(*(float(way[each].sum()) for each in (~known, fast, low)))
    return _evidence(s, rows, sd[rows] / scale[rows], floor), lost


def _expected_sd(measured: Floats, sd: Floats, scale: Floats) -> Floats:
    """Return standard errors as if each stretch had measured what is expected of it, ``scale``; all (n,), rad/m.

    Errors that grow with what was measured would otherwise give low readings more weight than high ones.
    """
    above = np.log(np.maximum(measured, _LEAST_SHARE * sd + _TINY) / scale)
    terms = np.column_stack((np.ones(len(sd)), np.log(scale), above))
    growth = np.linalg.lstsq(terms, np.log(sd + _TINY), rcond=None)[0][2] if len(sd) >= _LEAST_STRETCHES else 0.0
    return np.asarray(sd * np.exp(-np.clip(growth, 0.0, 1.0) * above))


def _evidence(s: DrivenStretches, rows: NDArray[np.bool_], relative: Floats, floor: float) -> DriveEvidence:
    c_r, place, sd, way = s.c_r[rows], np.nan_to_num(s.place_sd[rows]), s.measured_sd[rows], s.way_m[rows]
    without_floor = np.sqrt(np.maximum(c_r**2 - floor**2, (_LEAST_SHARE * c_r) ** 2))
    place_of = np.column_stack((s.easting[rows], s.northing[rows]))
    drive = s.drive[rows]
    return DriveEvidence(
        log_c_r=np.log(without_floor),
        log_measured=np.log(np.maximum(s.measured[rows], _LEAST_SHARE * sd + _TINY)),
        own_variance=relative**2 + (place / c_r) ** 2,
        map_sd=np.maximum(np.log(s.c_r_high[rows] / s.c_r_low[rows]) / _INTERVAL_SD, _LEAST_MAP_SD),
        square=_numbered(np.floor(place_of / SQUARE_M).astype(np.int64)),
        fold=_folds(drive, s.start_s[rows], way),
        drive=drive,
        way_m=way,
        new_m=way / _times_driven(place_of, way),
    )


def _numbered(values: Integers) -> Integers:
    """Return numbers of the rows from 0, alike for equal ones."""
    return np.unique(values, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _times_driven(place: Floats, way: Floats) -> Floats:
    """Return how often the ground of each stretch was driven, (n,): 1 for a way that does not cross itself.

    Stretches count by how far they overlap: those whose middles are a stretch apart do not.
    """
    times = np.ones(len(way))
    for first in range(0, len(way), 256):
        part = slice(first, first + 256)
        away = np.hypot(*(place[part, None, :] - place[None, :, :]).transpose(2, 0, 1))
        times[part] = np.maximum(1.0 - away / way[part, None], 0.0).sum(axis=1)
    return times


def _folds(drive: Integers, start_s: Floats, way: Floats) -> Integers:
    """Return which stretches are left out together: whole drives, or pieces of the way of at least 50 m."""
    number = _numbered(drive)
    if len(np.unique(drive)) >= _LEAST_DRIVES:
        return number % _FOLDS
    order = np.lexsort((start_s, number))
    before = np.zeros(len(way))
    before[order] = np.cumsum(way[order]) - way[order]
    total = float(way.sum())
    pieces = min(_FOLDS, max(int(total // _FOLD_M), 2))
    return np.minimum((before / max(total, 1e-9) * pieces).astype(np.int64), pieces - 1)
