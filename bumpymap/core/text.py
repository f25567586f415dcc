"""Text of messages and pages: counted things, shares that add up, and messages of several lines in one."""

import math
from collections.abc import Collection, Iterable, Sequence

__all__ = ["count_text", "join_lines", "share_text", "shares_text"]


def count_text(count: int, one: str, many: str = "") -> str:
    """Return a number with what it counts: ``1 survey``, ``1,200 surveys``; ``many`` if it is not ``one`` and an s."""
    return f"{count:,} {one if count == 1 else many or f'{one}s'}"


def join_lines(lines: Iterable[object]) -> str:
    """Return the lines of a message as one: sentences end, and indented lines are the items of a list."""
    joined, was_item = "", False
    for line in map(str, lines):
        text, is_item = line.strip(), line.startswith(" ")
        if not text:
            continue
        if joined and joined[-1] not in ".:;!?":
            joined += ";" if is_item and was_item else ":" if is_item else "."
        joined += f" {text}" if joined else text
        was_item = is_item
    return joined


def share_text(share: float, decimals: int = 0, percent: str = "%") -> str:
    """Return a share, 0 to 1, in per cent; a small one is not rounded to nothing, nor a large one to all."""
    return _shown(share, _rounded(share, decimals), decimals, percent)


def shares_text(
    counts: Sequence[float], alone: Collection[int] = (), decimals: int = 0, percent: str = "%"
) -> list[str]:
    """Return the shares of all parts of a whole, rounded so that together they make 100 %.

    Parameters
    ----------
    counts : sequence of float
        Size of each part; together they are the whole.
    alone : collection of int
        Parts whose share is told elsewhere too: they are rounded as `share_text` does.
    decimals : int
    percent : str
        Follows each number.

    Notes
    -----
    The other parts are rounded down, and those with the largest remainders get what is left.
    """
    total = sum(counts)
    if not total:
        return [share_text(0.0, decimals, percent) for _ in counts]
    exact = [count / total * 10.0 ** (2 + decimals) for count in counts]
    units = [
        _rounded(count / total, decimals) if place in alone else math.floor(exact[place] + 1e-9)
        for place, count in enumerate(counts)
    ]
    left = round(10.0 ** (2 + decimals)) - sum(units)
    others = sorted(set(range(len(counts))) - set(alone), key=lambda place: units[place] - exact[place])
    for place in others[:left] if left > 0 else others[len(others) + left :]:
        units[place] += 1 if left > 0 else -1
    return [_shown(count / total, unit, decimals, percent) for count, unit in zip(counts, units, strict=True)]


def _rounded(share: float, decimals: int) -> int:
    """Return a share in units of the last digit shown."""
    return round(share * 10.0 ** (2 + decimals))


def _shown(share: float, units: int, decimals: int, percent: str) -> str:
    least = 10.0**-decimals
    if 0 < 100 * share < least:
        return f"under {least:.{decimals}f}{percent}"
    if 100 - least < 100 * share < 100:
        return f"over {100 - least:.{decimals}f}{percent}"
    return f"{units * least:.{decimals}f}{percent}"
