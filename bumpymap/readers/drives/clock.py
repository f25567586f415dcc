"""Times of samples: numbers and text, their unit, their order, and what is wrong with them."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.drives.signals import Floats

__all__ = [
    "TimeNumbers",
    "days_of_text",
    "in_order",
    "numbers_of_times",
    "seconds_of_numbers",
    "seconds_of_text",
    "sorted_times",
]

_DATE = r"(?P<year>\d{4})[-/.](?P<month>\d\d?)[-/.](?P<day>\d\d?)"
_CLOCK = r"(?P<hour>\d\d?):(?P<minute>\d\d):(?P<second>\d\d(?:\.\d+)?)"
_ZONE = r"(?:Z| ?UTC|(?P<zone>[-+]\d\d)(?::?(?P<zone_minute>\d\d))?)?"
_DAY_S = 86_400


def seconds_of_text(column: Any) -> tuple[Floats, bool] | None:
    """Return the times of a column of text.

    Parameters
    ----------
    column : pyarrow array of strings (n,)
        ``2026-05-01 12:00:00.250``, ``2026/05/01T12:00:00+02:00``, or times of day ``12:00:00.250``.

    Returns
    -------
    ((n,) float64, bool) or None
        Seconds since 1970, or since midnight; whether there is a date. NaN where a value is missing. None if a value
        is of another form.
    """
    parts = _parts(column, rf"^\s*{_DATE}[ T]+{_CLOCK}\s*{_ZONE}\s*$")
    if parts is not None:
        zone = np.nan_to_num(parts["zone"]) * 3600.0
        zone += np.copysign(np.nan_to_num(parts["zone_minute"]) * 60.0, parts["zone"])
        return _days(parts) * _DAY_S + _clock(parts) - zone, True
    parts = _parts(column, rf"^\s*{_CLOCK}\s*Z?\s*$")
    return None if parts is None else (_clock(parts), False)


def days_of_text(column: Any) -> Floats | None:
    """Return the dates of a column of text, (n,) days since 1970; None if a value is of another form."""
    parts = _parts(column, rf"^\s*{_DATE}\s*$")
    return None if parts is None else _days(parts)


def _parts(column: Any, pattern: str) -> dict[str, Floats] | None:
    """Return the numbers that a pattern captures, NaN where there are none; None if a value is of another form."""
    import pyarrow as pa
    from pyarrow import compute

    words = column.cast(pa.string())
    found = compute.extract_regex(words, pattern)
    if found.null_count > words.null_count:
        return None
    names = [field.name for field in found.type]
    numbers = {}
    for name, values in zip(names, found.flatten(), strict=True):
        filled = compute.if_else(compute.equal(values, ""), None, values)
        numbers[name] = np.asarray(filled.cast(pa.float64()).to_numpy(zero_copy_only=False), np.float64)
    return numbers


def _clock(parts: dict[str, Floats]) -> Floats:
    return parts["hour"] * 3600.0 + parts["minute"] * 60.0 + parts["second"]


def _days(parts: dict[str, Floats]) -> Floats:
    """Return days since 1970 of years, months and days."""
    known = np.isfinite(parts["year"])
    months = (np.nan_to_num(parts["year"]) - 1970) * 12 + np.nan_to_num(parts["month"], nan=1.0) - 1
    first = months.astype(np.int64).astype("datetime64[M]").astype("datetime64[D]").astype(np.int64)
    return np.where(known, first + parts["day"] - 1.0, np.nan)


_EPOCH = (("s", 1e8, 1e10), ("ms", 1e11, 1e13), ("us", 1e14, 1e16), ("ns", 1e17, 1e19))
"""Unit, from, to: times since 1970 (from 1973 on) tell their unit by their size."""
_FACTOR = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_STEP_S = {"rates": (2e-4, 0.3), "positions": (0.004, 5.0)}
"""Time between two samples, from and to, s: other times between them are in another unit."""
_SLOWEST_S = {"rates": 0.6, "positions": 60.0}
"""A longer time between two samples says that times are not since 1970, but since a start, in a smaller unit."""
_MOST_REPEATED = 0.5


class TimeNumbers(NamedTuple):
    """The times of a column as numbers."""

    values: NDArray[Any]
    """(n,) float64, NaN where missing, or int64."""
    unit: str | None = None
    """Unit, if they were dates or times of day."""
    has_date: bool = True
    """False: they were times of day."""


def numbers_of_times(column: Any, source: str, name: str) -> TimeNumbers:
    """Return the times of a column of pyarrow as numbers.

    Raises
    ------
    BadInputError
        The column holds text that is no time.
    """
    from pyarrow import types

    kind = column.type
    if types.is_timestamp(kind):
        stamps = column.to_numpy().astype("datetime64[ns]")
        whole = stamps.astype(np.int64)
        missing = np.isnat(stamps)
        return TimeNumbers(np.where(missing, np.nan, whole) if missing.any() else whole, "ns")
    if types.is_integer(kind) and column.null_count == 0:
        return TimeNumbers(column.to_numpy())
    if types.is_integer(kind) or types.is_floating(kind) or types.is_null(kind):
        return TimeNumbers(column.to_numpy().astype(np.float64))
    found = seconds_of_text(column)
    if found is not None:
        return TimeNumbers(found[0], "s", has_date=found[1])
    words = column.drop_null()
    raise BadInputError(
        f"the times of {source} (column {name}) are text such as '{words[0] if len(words) else ''}'. Write seconds, "
        "or dates such as 2026-05-01 12:00:00.250"
    )


def seconds_of_numbers(
    numbers: NDArray[Any], unit: str | None, kind: str, where: tuple[str, str]
) -> tuple[Floats, str | None]:
    """Return times in seconds, and a note if their unit was guessed.

    Parameters
    ----------
    numbers : (n,) float64 or int64
    unit : str or None
        ``s``, ``ms``, ``us`` or ``ns``. None: found from the size of times since 1970, else from the time between two
        samples.
    kind : {"rates", "positions"}
        What is sampled; rates come more often.
    where : (str, str)
        Name of the file and of the column, for messages.

    Raises
    ------
    BadInputError
        There is no time, or the unit cannot be found.
    """
    source, name = where
    finite = numbers[np.isfinite(numbers)] if numbers.dtype.kind == "f" else numbers
    if not len(finite):
        raise BadInputError(f"the column {name} of {source} holds no times. Name the right one: `columns='time=NAME'`")
    note = None
    if unit is None:
        unit = _unit_of(finite, kind)
        if unit is None:
            raise BadInputError(
                f"the unit of the times of {source} (column {name}) cannot be determined: between two samples it "
                f"rises by {_median_step(finite):g} (median). State it: `columns='time={name}[ms]'` (s, ms, us or ns)"
            )
        note = f"times of {source} (column {name}) are taken as {unit}" if unit != "s" else None
    return numbers * np.float64(_FACTOR.get(unit, 60.0)), note


def _unit_of(numbers: NDArray[Any], kind: str) -> str | None:
    middle, step = float(np.median(numbers)), _median_step(numbers)
    since_1970 = next((unit for unit, least, most in _EPOCH if least <= middle < most), None)
    if since_1970 is not None and not step * _FACTOR[since_1970] > _SLOWEST_S[kind]:
        return since_1970
    least_s, most_s = _STEP_S[kind]
    # The first unit that will do: the next one differs by a factor of 1000, almost the whole range.
    return next((unit for unit, factor in _FACTOR.items() if least_s <= step * factor <= most_s), None)


def _median_step(numbers: NDArray[Any]) -> float:
    steps = np.diff(np.unique(numbers))
    return float(np.median(steps)) if len(steps) else np.nan


def in_order(time: Floats, what: str) -> tuple[NDArray[np.intp], str | None]:
    """Return which samples to keep: of equal times the first one; and a note if any were left out.

    Parameters
    ----------
    time : (n,) float64
        Seconds, finite.
    what : str
        What was sampled, for messages: ``the angular rates of imu.csv``.

    Raises
    ------
    BadInputError
        Times run backwards, or most of them repeat.
    """
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0.0)
    if len(back):
        place = int(back[0])
        count = "once" if len(back) == 1 else f"{len(back):,} times"
        raise BadInputError(
            f"the times of {what} run backwards {count}, first from {time[place]:.3f} s to "
            f"{time[place + 1]:.3f} s at sample {place + 2:,}. If these are several drives, give each as its own file; "
            "if the clock was set while recording, use a time that runs on, such as the time since the start"
        )
    keep = np.flatnonzero(np.append(True, steps > 0.0)[: len(time)])
    repeated = len(time) - len(keep)
    if repeated > _MOST_REPEATED * len(time):
        raise BadInputError(
            f"{repeated:,} of the {len(time):,} times of {what} repeat the one before: the column of times is too "
            "coarse (whole seconds?). Name a finer one: `columns='time=NAME[unit]'`"
        )
    note = f"{repeated:,} samples of {what} repeat the time before them and are left out" if repeated else None
    return keep, note


def sorted_times(time: Floats, what: str, notes: list[str]) -> NDArray[np.intp]:
    """Return the order of messages by their stamps; a recorder stores them as they arrive."""
    late = int((np.diff(time) < 0.0).sum())
    if late:
        notes.append(f"{late:,} messages of {what} arrived after later ones and are sorted by their stamps")
    order: NDArray[np.intp] = np.argsort(time, kind="stable")
    return order
