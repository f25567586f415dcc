"""Join the signals of the files of a drive to one record."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from bumpymap.core import BadInputError, DriveLog, ImuTrack, PlaceTrack, WheelTrack
from bumpymap.readers.drives.attitude import body_rates
from bumpymap.readers.drives.quantities import (
    ACCELERATIONS,
    ANGLES,
    EASTING_NORTHING,
    LOCAL,
    LONLAT,
    QUATERNION,
    RATES,
    SIDES,
)
from bumpymap.readers.drives.signals import DriveSignals, Floats, Signal

__all__ = ["assemble"]

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
"""Two recordings that begin so near each other, but for so many whole hours, are told in two time zones."""
_BRIDGED_S = 0.25
"""Accelerations are interpolated over at most so much time."""


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
    places = _places(sources, columns, notes)
    wheels = _wheels(sources, columns, notes)
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


def _imu(name: str, sources: Sequence[DriveSignals], columns: dict[str, str], notes: list[str]) -> ImuTrack:
    with_rate = [source for source in sources if source.rate is not None]
    with_rate.sort(key=lambda each: (each.acceleration is None, -len(each.rate.time if each.rate else ())))
    if with_rate:
        source = with_rate[0]
        rate = source.rate
        kind = "rate"
        if len(with_rate) > 1:
            notes.append(f"angular rates are read from {source.source}; {_others(with_rate)} has some too")
    else:
        source = _best_attitude(name, sources)
        rate = body_rates(source.attitude) if source.attitude is not None else None
        kind = "attitude"
        notes.append(f"{source.source} has no angular rates: they are differences of its attitudes")
    columns.update(_taken(kind, source, sources))
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


def _others(sources: Sequence[DriveSignals]) -> str:
    return ", ".join(source.source for source in sources[1:])


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


def _places(sources: Sequence[DriveSignals], columns: dict[str, str], notes: list[str]) -> PlaceTrack | None:
    found = [source for source in sources if source.places is not None]
    found.sort(key=lambda each: _KINDS.index(each.places.kind) if each.places else len(_KINDS))
    if not found:
        return None
    if len(found) > 1:
        notes.append(f"positions are read from {found[0].source}; {_others(found)} has some too")
    columns.update({key: text for key, text in _taken("places", found[0], sources).items() if key not in columns})
    return found[0].places


def _wheels(sources: Sequence[DriveSignals], columns: dict[str, str], notes: list[str]) -> WheelTrack | None:
    found = [source for source in sources if source.wheels is not None]
    found.sort(key=lambda each: bool(each.wheels is None or np.isnan(each.wheels.difference).all()))
    if not found:
        return None
    if len(found) > 1:
        notes.append(f"speeds are read from {found[0].source}; {_others(found)} has some too")
    columns.update({key: text for key, text in _taken("wheels", found[0], sources).items() if key not in columns})
    return found[0].wheels


def _require_common_clock(name: str, what: str, imu: Floats, times: Floats) -> None:
    if times[-1] < imu[0] or times[0] > imu[-1]:
        hours = round(float(times[0] - imu[0]) / 3600.0)
        zone = abs(times[0] - imu[0] - hours * 3600.0) < _NEAR_S and 0 < abs(hours) <= _MOST_HOURS
        hint = f" They are {abs(hours)} h apart, like a time zone: write both in UTC." if zone else ""
        raise BadInputError(
            f"the {what} of {name} have no time in common with its angular rates: {_span(times)} against {_span(imu)}."
            f"{hint or ' Write both with times of the same clock'}"
        )


def _span(times: Floats) -> str:
    return f"{times[0]:.3f} to {times[-1]:.3f} s"


def _gaps(what: str, times: Floats) -> list[str]:
    steps = np.diff(times)
    if not len(steps):
        return []
    gaps = steps[steps > max(_GAP * float(np.median(steps)), _LEAST_GAP_S[what])]
    if not len(gaps):
        return []
    return [f"{what} have {len(gaps):,} gap{'s' * (len(gaps) > 1)}, the longest of {gaps.max():.2f} s"]
