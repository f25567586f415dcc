"""Times that are text: dates in several forms, times of day, with fractions of seconds and time zones."""

from typing import Any

import numpy as np

from bumpymap.readers.drives.signals import Floats

__all__ = ["days_of_text", "seconds_of_text"]

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
    flat = found.combine_chunks().flatten() if isinstance(found, pa.Array) else _flat(found)
    numbers = {}
    for name, values in zip(names, flat, strict=True):
        filled = compute.if_else(compute.equal(values, ""), None, values)
        numbers[name] = np.asarray(filled.cast(pa.float64()).to_numpy(zero_copy_only=False), np.float64)
    return numbers


def _flat(found: Any) -> list[Any]:
    return [each.combine_chunks() for each in found.flatten()]


def _clock(parts: dict[str, Floats]) -> Floats:
    return parts["hour"] * 3600.0 + parts["minute"] * 60.0 + parts["second"]


def _days(parts: dict[str, Floats]) -> Floats:
    """Return days since 1970 of years, months and days."""
    known = np.isfinite(parts["year"])
    months = (np.nan_to_num(parts["year"]) - 1970) * 12 + np.nan_to_num(parts["month"], nan=1.0) - 1
    first = months.astype(np.int64).astype("datetime64[M]").astype("datetime64[D]").astype(np.int64)
    return np.where(known, first + parts["day"] - 1.0, np.nan)
