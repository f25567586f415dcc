"""The signals of one file of a drive: quantities, units and attitudes; and how the files are joined to one record."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import pi
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, DriveLog, ImuTrack, PlaceTrack, WheelTrack

__all__ = [
    "ACCELERATIONS",
    "ANGLES",
    "DIMENSIONS",
    "EASTING_NORTHING",
    "LOCAL",
    "LONLAT",
    "QUANTITIES",
    "QUATERNION",
    "RATES",
    "SIDES",
    "UNITS",
    "DriveSignals",
    "Floats",
    "Signal",
    "assemble",
    "attitudes",
    "body_rates",
    "plain_unit",
    "quaternions_of_angles",
]

RATES = ("rate_x", "rate_y", "rate_z")
ACCELERATIONS = ("acc_x", "acc_y", "acc_z")
ANGLES = ("roll", "pitch", "yaw")
QUATERNION = ("q_x", "q_y", "q_z", "q_w")
LONLAT = ("longitude", "latitude")
EASTING_NORTHING = ("easting", "northing")
LOCAL = ("x", "y")
SIDES = ("speed_left", "speed_right")
DIMENSIONS: Mapping[str, str] = {
    "time": "time",
    "nanosec": "time",
    "date": "time",
    **dict.fromkeys(RATES, "rate"),
    **dict.fromkeys(ACCELERATIONS, "acceleration"),
    **dict.fromkeys(ANGLES, "angle"),
    **dict.fromkeys(QUATERNION, "number"),
    **dict.fromkeys(LONLAT, "degree"),
    **dict.fromkeys((*EASTING_NORTHING, *LOCAL, "error"), "length"),
    **dict.fromkeys(("speed", *SIDES), "speed"),
    "fix": "number",
}
"""Quantity -> what its unit is a unit of."""
QUANTITIES = tuple(DIMENSIONS)
_G = 9.80665
_DEGREE = pi / 180.0
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "rate": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEGREE, "mdeg/s": 1e-3 * _DEGREE},
    "acceleration": {"m/s2": 1.0, "g": _G, "mg": 1e-3 * _G},
    "angle": {"rad": 1.0, "deg": _DEGREE},
    "degree": {"deg": 1.0, "rad": 1.0 / _DEGREE, "dege7": 1e-7},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "mph": 0.44704},
    "number": {"": 1.0},
}
"""Dimension -> unit, as `plain_unit` spells it -> factor to the unit of `DriveLog`."""
_SPELLED = {
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "msecs", "millis", "millisec", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "usecs", "micros", "microsec", "microseconds"), "us"),
    **dict.fromkeys(("nsec", "nsecs", "nanos", "nanosec", "nanoseconds"), "ns"),
    **dict.fromkeys(("rads", "rad/sec", "radps", "radians/s", "radian/s", "rps"), "rad/s"),
    **dict.fromkeys(("dps", "degs", "deg/sec", "degps", "degrees/s", "degree/s"), "deg/s"),
    **dict.fromkeys(("mdps", "mdegs"), "mdeg/s"),
    **dict.fromkeys(("ms2", "ms-2", "mps2", "m/s/s", "m/s/2", "m/sec2", "mss"), "m/s2"),
    **dict.fromkeys(("gs", "gee", "g0"), "g"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("degree", "degrees", "d"), "deg"),
    **dict.fromkeys(("e7", "dege-7", "1e-7deg", "1e7deg"), "dege7"),
    **dict.fromkeys(("meter", "metre", "meters", "metres"), "m"),
    **dict.fromkeys(("mps", "m/sec"), "m/s"),
    **dict.fromkeys(("kmh", "kph", "kmph", "km/hr"), "km/h"),
}
_LETTERS = str.maketrans({"µ": "u", "μ": "u", "°": "deg", "²": "2", "^": "", "*": "", " ": "", "_": "/"})


def plain_unit(text: str, dimension: str) -> str | None:
    """Return a unit of a dimension as `UNITS` spells it: ``Deg/sec``, ``deg_s``, ``dps`` are ``deg/s``; or None."""
    unit = text.strip().lower().translate(_LETTERS)
    unit = re.sub(r"/?per/?", "/", unit)
    unit = _SPELLED.get(unit, unit)
    return unit if unit in UNITS[dimension] else None


_FEWEST = 20
"""Samples of angular rates."""
_SLOWEST_S = 1.0
"""Median time between two angular rates."""
_KINDS = ("lonlat", "projected", "local")
_COLUMNS = {
    "rate": (*RATES, "imu"),
    "acceleration": (*ACCELERATIONS, "imu"),
    "attitude": (*ANGLES, *QUATERNION, "imu", "odometry", "attitude"),
    "places": (*LONLAT, *EASTING_NORTHING, *LOCAL, "error", "fix", "gnss", "odometry"),
    "wheels": ("speed", *SIDES, "odometry", "twist"),
}
_GAP = 5.0
"""A gap is so many times the median time between two samples, and at least `_LEAST_GAP_S`."""
_LEAST_GAP_S = {"angular rates": 0.1, "positions": 2.0, "wheel speeds": 1.0}


_NEAR_S, _MOST_HOURS = 300.0, 14
"""Two recordings that begin so near each other, but for so many whole hours, are given in two time zones."""
_ROUNDING = 0.1
"""Tolerance of the lengths of quaternions."""
_BRIDGED_S = 0.25
"""Accelerations are interpolated over at most so much time."""


Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Signal:
    """Samples of one sensor."""

    time: Floats
    """(n,) s, increasing."""
    values: Floats
    """(n, k), finite."""


@dataclass(frozen=True, slots=True)
class DriveSignals:
    """The samples of one file, or of one bag."""

    source: str
    """Name of the file, for messages."""
    rate: Signal | None = None
    """Angular rates about x, y, z, rad/s."""
    acceleration: Signal | None = None
    """Specific force along x, y, z, m/s2."""
    attitude: Signal | None = None
    """Quaternions x, y, z, w that turn vectors of the sensor's axes into those of a fixed frame."""
    places: PlaceTrack | None = None
    wheels: WheelTrack | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    """Quantity -> column or topic."""
    notes: tuple[str, ...] = ()
    listing: str = ""
    """Content of the file, for the message that something is missing."""


def assemble(name: str, paths: Sequence[Path], sources: Sequence[DriveSignals]) -> DriveLog:
    """Join signals to a drive.

    Raises
    ------
    BadInputError
        No source has angular rates or attitudes, they are too few, or the clocks of the sources have nothing in common.
    """
    notes = [note for source in sources for note in source.notes]
    columns: dict[str, str] = {}
    imu = _imu(name, sources, columns, notes)
    placed = [source for source in sources if source.places is not None]
    placed.sort(key=lambda each: _KINDS.index(each.places.kind) if each.places else len(_KINDS))
    place = _first("places", "positions", placed, sources, columns, notes)
    rolling = [source for source in sources if source.wheels is not None]
    rolling.sort(key=lambda each: bool(each.wheels is None or np.isnan(each.wheels.difference).all()))
    roll = _first("wheels", "speeds", rolling, sources, columns, notes)
    places, wheels = place.places if place else None, roll.wheels if roll else None
    for what, track in (("positions", places), ("wheel speeds", wheels)):
        if track is not None:
            _require_common_clock(name, what, imu.time, track.time)
    for what, times in (("angular rates", imu), ("positions", places), ("wheel speeds", wheels)):
        if times is not None:
            notes.extend(_gaps(what, times.time))
    return DriveLog(name, tuple(paths), imu, places, wheels, columns, tuple(notes))


def _taken(kind: str, source: DriveSignals, sources: Sequence[DriveSignals]) -> Mapping[str, str]:
    """Return the columns of a source that a signal was read from, with the name of the file if there are several."""
    several = sum(bool(each.columns) for each in sources) > 1
    return {
        key: f"{source.source}: {text}" if several and text != source.source else text
        for key, text in source.columns.items()
        if key in {*_COLUMNS[kind], "time"}
    }


def _first(
    kind: str,
    what: str,
    found: Sequence[DriveSignals],
    sources: Sequence[DriveSignals],
    columns: dict[str, str],
    notes: list[str],
) -> DriveSignals | None:
    """Return the first of some sources; say which columns are taken, and which sources have the same too."""
    if not found:
        return None
    if len(found) > 1:
        others = ", ".join(source.source for source in found[1:])
        notes.append(f"{what} are read from {found[0].source}; {others} has some too")
    columns.update({key: text for key, text in _taken(kind, found[0], sources).items() if key not in columns})
    return found[0]


def _imu(name: str, sources: Sequence[DriveSignals], columns: dict[str, str], notes: list[str]) -> ImuTrack:
    with_rate = [source for source in sources if source.rate is not None]
    with_rate.sort(key=lambda each: (each.acceleration is None, -len(each.rate.time if each.rate else ())))
    source = _first("rate", "angular rates", with_rate, sources, columns, notes)
    rate = None if source is None else source.rate
    if source is None:
        source = _best_attitude(name, sources)
        rate = body_rates(source.attitude) if source.attitude is not None else None
        notes.append(f"{source.source} has no angular rates: they are differences of its attitudes")
        columns.update(_taken("attitude", source, sources))
    if rate is None or len(rate.time) < _FEWEST:
        raise BadInputError(
            f"{name} has {0 if rate is None else len(rate.time)} samples of angular rates; at least {_FEWEST} are "
            "required, and a drive has thousands. Was the recording cut off?"
        )
    step = float(np.median(np.diff(rate.time)))
    if step > _SLOWEST_S:
        raise BadInputError(
            f"the angular rates of {name} are {step:.3g} s apart, which is no recording of an IMU. If times are in "
            "another unit, state it: `columns='time=NAME[ms]'`"
        )
    with_acceleration = sorted(
        (each for each in sources if each.acceleration is not None), key=lambda each: each is not source
    )
    if not with_acceleration:
        return ImuTrack(rate.time, rate.values, np.full(rate.values.shape, np.nan))
    columns.update({**_taken("acceleration", with_acceleration[0], sources), **columns})
    return ImuTrack(rate.time, rate.values, _at(rate.time, with_acceleration[0].acceleration))


def _best_attitude(name: str, sources: Sequence[DriveSignals]) -> DriveSignals:
    found = [source for source in sources if source.attitude is not None]
    if found:
        return max(found, key=lambda each: len(each.attitude.time if each.attitude else ()))
    held = "; ".join(source.listing for source in sources if source.listing)
    raise BadInputError(
        f"{name} has neither angular rates nor attitudes that are known by their names. It holds {held}. Name the "
        "columns: `columns='rate_x=NAME[deg/s],rate_y=NAME[deg/s],rate_z=NAME[deg/s]'`"
    )


def _at(times: Floats, signal: Signal | None) -> Floats:
    """Interpolate a signal at times; NaN where its samples are too far away."""
    if signal is None:
        return np.full((len(times), 3), np.nan)
    if np.array_equal(times, signal.time):
        return signal.values
    values = np.stack([np.interp(times, signal.time, column) for column in signal.values.T], axis=1)
    after = np.clip(np.searchsorted(signal.time, times), 1, max(len(signal.time) - 1, 1))
    last = signal.time[np.minimum(after, len(signal.time) - 1)]
    far = np.maximum(last - times, times - signal.time[after - 1]) > _BRIDGED_S
    exact = np.isin(times, signal.time)
    return np.where((far & ~exact)[:, None], np.nan, values)


def _require_common_clock(name: str, what: str, imu: Floats, times: Floats) -> None:
    if times[-1] < imu[0] or times[0] > imu[-1]:
        hours = round(float(times[0] - imu[0]) / 3600.0)
        zone = abs(times[0] - imu[0] - hours * 3600.0) < _NEAR_S and 0 < abs(hours) <= _MOST_HOURS
        hint = f" They are {abs(hours)} h apart, like a time zone: write both in UTC." if zone else ""
        raise BadInputError(
            f"the {what} of {name} have no time in common with its angular rates: {times[0]:.3f} to {times[-1]:.3f} s "
            f"against {imu[0]:.3f} to {imu[-1]:.3f} s.{hint or ' Write both with times of the same clock'}"
        )


def _gaps(what: str, times: Floats) -> list[str]:
    steps = np.diff(times)
    gaps = steps[steps > max(_GAP * float(np.median(steps)), _LEAST_GAP_S[what])] if len(steps) else steps
    if not len(gaps):
        return []
    return [f"{what} have {len(gaps):,} gap{'s' * (len(gaps) > 1)}, the longest of {gaps.max():.2f} s"]


def attitudes(time: Floats, values: Floats) -> Signal | None:
    """Return the quaternions, (n, 4), whose length is about 1; None if they are fewer than two."""
    with np.errstate(invalid="ignore", over="ignore"):
        good = np.abs(np.linalg.norm(values, axis=1) - 1.0) < _ROUNDING
    return Signal(time[good], values[good]) if good.sum() > 1 else None


_LONGEST_STEP_S = 0.5
"""Between attitudes further apart, nothing is known about the rate."""


def quaternions_of_angles(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    """Return quaternions, (n, 4) x, y, z, w, of angles, (n,) rad.

    They turn by yaw about z, then by pitch about the new y, then by roll about the new x.
    """
    cr, sr, cp, sp, cy, sy = (f(0.5 * angle) for angle in (roll, pitch, yaw) for f in (np.cos, np.sin))
    return np.stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ],
        axis=1,
    )


def body_rates(attitude: Signal) -> Signal:
    """Return the angular rates about the sensor's own axes between each two attitudes that follow each other.

    Parameters
    ----------
    attitude : Signal
        Quaternions (n, 4), x, y, z, w, of any length but 0.

    Returns
    -------
    Signal
        Rates (m, 3), rad/s, constant rotation being assumed from one attitude to the next, in the middle of both. None
        across gaps of more than half a second.
    """
    q = attitude.values / np.linalg.norm(attitude.values, axis=1, keepdims=True)
    step = np.diff(attitude.time)
    before, after = q[:-1], q[1:]
    # The turn from one to the next in the sensor's axes: conjugate of the first times the second.
    vector = before[:, 3:] * after[:, :3] - after[:, 3:] * before[:, :3] - np.cross(before[:, :3], after[:, :3])
    scalar = (before * after).sum(axis=1, keepdims=True)
    vector, scalar = np.where(scalar < 0.0, -vector, vector), np.abs(scalar)  # q and -q are the same attitude
    sine = np.linalg.norm(vector, axis=1, keepdims=True)
    # angle / sine tends to 2 for no turn at all
    factor = np.where(sine > 1e-9, 2.0 * np.arctan2(sine, scalar) / np.maximum(sine, 1e-9), 2.0)
    near = step <= _LONGEST_STEP_S
    rates = vector * factor / step[:, None]
    return Signal((attitude.time[:-1] + 0.5 * step)[near], rates[near])
