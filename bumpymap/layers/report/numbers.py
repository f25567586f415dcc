"""Numbers as the page shows them."""

import math
from collections.abc import Collection, Sequence
from typing import Any

from bumpymap.core import share_text, shares_text

__all__ = ["DASH", "area", "number", "share", "shares", "whole"]

DASH = "\N{EN DASH}"
"""Stands where nothing is known."""
_PERCENT = "\N{NO-BREAK SPACE}%"
_SQUARE_KILOMETRE = 1e6
_HECTARE = 1e4


def number(value: Any, decimals: int, unit: str = "") -> str:
    """Return a number with its unit; a dash if it is not known."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return DASH
    return f"{value:,.{decimals}f}{unit}"


def whole(value: int) -> str:
    """Return a whole number with its thousands apart."""
    return f"{value:,}"


def share(part: float, total: float) -> str:
    """Return a share in per cent; small shares are not rounded to nothing, nor large ones to all."""
    return share_text(part / total, percent=_PERCENT) if total else DASH


def shares(counts: Sequence[float], alone: Collection[int] = ()) -> list[str]:
    """Return the shares of all parts of a whole, which make 100 % together; see `shares_text`."""
    return shares_text(counts, alone, percent=_PERCENT) if sum(counts) else [DASH] * len(counts)


def area(square_metres: float) -> str:
    """Return an area in m2, ha or km2."""
    if square_metres >= _SQUARE_KILOMETRE:
        return f"{square_metres / _SQUARE_KILOMETRE:,.2f} km²"
    if square_metres >= _HECTARE:
        return f"{square_metres / _HECTARE:,.2f} ha"
    return f"{square_metres:,.0f} m²"
