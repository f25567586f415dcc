"""Connected changes: small ones are left out, the others are described."""

from collections import defaultdict
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CHANGE_KINDS, NO_CLASS, Barred
from bumpymap.layers import SurveyTiles, label

__all__ = ["connect", "describe_regions", "region_names"]

_DECIMALS = 4


def connect(code: NDArray[np.float64], least: int) -> tuple[NDArray[np.float64], NDArray[np.int32], int]:
    """Find connected changes, of tiles that share a side, and drop those of fewer than ``least`` tiles.

    ``code`` (rows, cols): a position in ``CHANGE_KINDS``; NaN where not compared. Returns ``code`` (rows, cols): 0
    where a change was dropped; ``area`` (rows, cols): number of the change, from 1, in the order of their first tiles;
    0: none; ``dropped``: tiles of the changes that were dropped.
    """
    found = np.nan_to_num(code) > 0.0
    labels, first, _ = label(found.astype(np.uint8))
    size = np.bincount(labels.ravel(), minlength=len(first) + 1)
    kept = size >= least
    kept[0] = False
    number = np.where(kept, np.cumsum(kept), 0).astype(np.int32)
    area = number[labels]
    small = found & (area == 0)
    return np.where(small, 0.0, code), area, int(small.sum())


def describe_regions(
    area: NDArray[np.int32],
    code: NDArray[np.float64],
    values: Mapping[str, NDArray[np.floating]],
    surveys: tuple[SurveyTiles, SurveyTiles],
    tile_size: float,
) -> tuple[dict[str, Any], ...]:
    """Return the properties of each connected change, as they stand in change.geojson.

    ``area``, ``code`` (rows, cols): from `connect`; ``values``: ``d_height``, ``d_c_r``, ``z_height``, ``z_shape``,
    ``z_c_r``, each (rows, cols); ``surveys``: before and after; ``tile_size``: m.
    """
    before, after = surveys
    place = np.flatnonzero(area)
    order = place[np.argsort(area.ravel()[place], kind="stable")]
    cuts = np.flatnonzero(np.diff(area.ravel()[order])) + 1
    flat: dict[str, NDArray[Any]] = {name: array.ravel() for name, array in values.items()}
    flat |= {"c_r_before": before.c_r.ravel(), "c_r_after": after.c_r.ravel(), "kind": code.ravel()}
    flat |= {"class_before": before.class_id.ravel(), "class_after": after.class_id.ravel()}
    free = before.barred == Barred.NO, after.barred == Barred.NO
    flat |= {"passable_lost": (free[0] & ~free[1]).ravel(), "passable_won": (~free[0] & free[1]).ravel()}
    parts = np.split(order, cuts) if len(order) else []
    return tuple(_describe({name: array[tiles] for name, array in flat.items()}, tile_size**2) for tiles in parts)


def region_names() -> tuple[str, ...]:
    """Return the names of the properties that `describe_regions` gives, also where nothing has changed."""
    return tuple(_describe(defaultdict(lambda: np.zeros(1, np.uint8)), 1.0))


def _describe(tiles: Mapping[str, NDArray[Any]], area_m2: float) -> dict[str, Any]:
    """Return the properties of one change from the values of its tiles, (n,) each."""
    heights, kinds = tiles["d_height"], tiles["kind"]
    return {
        "tiles": len(kinds),
        "area_m2": round(len(kinds) * area_m2, 3),
        "kind": _kind(kinds),
        **{CHANGE_KINDS[kind].replace(",", "").replace(" ", "_"): int((kinds == kind).sum()) for kind in _KINDS},
        "d_height": _number(heights.mean()),
        "d_height_lowest": _number(heights.min()),
        "d_height_highest": _number(heights.max()),
        "volume_m3": _number(heights.sum() * area_m2),
        **{name: _mean(tiles[name]) for name in ("d_c_r", "c_r_before", "c_r_after")},
        **{name: _farthest(tiles[name]) for name in ("z_height", "z_shape", "z_c_r")},
        **{name: _commonest(tiles[name]) for name in ("class_before", "class_after")},
        **{name: int(tiles[name].sum()) for name in ("passable_lost", "passable_won")},
    }


_KINDS = range(1, len(CHANGE_KINDS))
_FIRST = (2, 4, 3, 1)
"""Kinds in the order in which they stand for a place where several have most tiles: rougher, unknown, and so on."""


def _kind(kinds: NDArray[np.floating]) -> str:
    """Return the kind of most tiles."""
    count = np.bincount(kinds.astype(np.int64), minlength=len(CHANGE_KINDS))
    return CHANGE_KINDS[max(_FIRST, key=lambda kind: int(count[kind]))]


def _number(value: float) -> float | None:
    return round(float(value), _DECIMALS) if np.isfinite(value) else None


def _mean(values: NDArray[np.floating]) -> float | None:
    known = values[np.isfinite(values)]
    return _number(known.mean()) if len(known) else None


def _farthest(values: NDArray[np.floating]) -> float | None:
    """Return the value farthest from 0."""
    known = values[np.isfinite(values)]
    return _number(known[np.argmax(np.abs(known))]) if len(known) else None


def _commonest(classes: NDArray[np.uint8]) -> int | None:
    """Return the class of most tiles, the lower of two; None if it is unknown."""
    commonest = int(np.argmax(np.bincount(classes)))
    return None if commonest == NO_CLASS else commonest
