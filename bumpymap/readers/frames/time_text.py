"""Times in text: numbers in seconds or parts of them, dates with a time of day, and time stamps in file names."""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["seconds_of_names", "seconds_of_words"]

_EPOCH = ((1e8, 1e10, 1.0), (1e11, 1e13, 1e-3), (1e14, 1e16, 1e-6), (1e17, 1e19, 1e-9))
"""From, to, unit in seconds: times since 1970 (from 1973 on) tell their unit by their size."""
_DATE = re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d(\.\d+)?Z?")
_STAMP = re.compile(r"(?<!\d)(?:(\d{9,10})([._])(\d{1,9})|(\d{13}|\d{16}|\d{19}))(?!\d)")
_WHOLE = re.compile(r"(?<!\d)\d{10}(?!\d)")


def seconds_of_words(words: Sequence[str], unit: float | None = None) -> NDArray[np.float64] | None:
    """Return the times that words hold, (n,) s; None if any is neither a number nor a date.

    Parameters
    ----------
    words : sequence of str
        Numbers, or dates such as ``2011-09-26 13:02:25.594360375``.
    unit : float, optional
        Unit of the numbers, s. None: told from their size if they are times since 1970; otherwise seconds.
    """
    if words and all(_DATE.fullmatch(word.strip()) for word in words):
        try:
            stamps = np.array([word.strip().rstrip("Z").replace(" ", "T") for word in words], "datetime64[ns]")
        except ValueError:  # the 31st of February
            return None
        return stamps.astype(np.int64).astype(np.float64) * 1e-9
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        return None
    if not len(numbers) or not np.isfinite(numbers).all():
        return None
    return numbers * (_unit_of(numbers) if unit is None else unit)


def _unit_of(numbers: NDArray[np.float64]) -> float:
    middle = float(np.median(numbers))
    return next((unit for least, most, unit in _EPOCH if least <= middle < most), 1.0)


def seconds_of_names(names: Sequence[str]) -> NDArray[np.float64] | None:
    """Return the times in the names of files, (n,) s since 1970; None if any has none.

    A time is seconds with a fraction (``1666877643.267394304``), seconds and nanoseconds (``1666877643_267394304``), or
    one number in s, ms, us or ns.
    """
    found = [_STAMP.search(name) or _WHOLE.search(name) for name in names]
    if not names or not all(found):
        return None
    matches = [match for match in found if match is not None]
    parts = [match.group(3) if match.re is _STAMP and match.group(3) else "" for match in matches]
    separated = {match.group(2) for match, part in zip(matches, parts, strict=True) if part}
    if separated and len(separated) + (not all(parts)) > 1:
        return None
    if separated == {"_"}:  # a whole number of ms, us or ns, perhaps without its zeros in front
        digits = next(size for size in (3, 6, 9) if max(map(len, parts)) <= size)
        times = np.array([int(m.group(1)) + int(m.group(3)) / 10**digits for m in matches])
    else:
        times = np.array([float(match.group()) for match in matches])
        times = times * _unit_of(times)
    return times if (times > _EPOCH[0][0]).all() else None
