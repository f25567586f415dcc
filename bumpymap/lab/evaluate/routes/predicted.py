"""What the map says of a line: C_r of the whole way with its interval, hazard, cost."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Barred, TileField

__all__ = ["LineFigures", "TilePieces", "cut_at_tiles", "predict_line", "shared_length", "tile_cost"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TilePieces:
    """The pieces of a line between the borders of tiles, in order."""

    row: NDArray[np.int64]
    """(n,) from the north of the window."""
    col: NDArray[np.int64]
    """(n,) from its west."""
    length: Floats
    """(n,) in tiles, above 0."""


@dataclass(frozen=True, slots=True)
class LineFigures:
    """Prediction for a whole line."""

    length_m: float
    c_r: float
    """Mean along the line where it is known, rad/m; NaN if it is known nowhere (so are the next three)."""
    c_r_low: float
    """Mean of the lower ends of the 80 % intervals: as if all tiles erred to the same side."""
    c_r_high: float
    c_r_raw: float
    """Mean of the prediction without noise correction, for the heights as they were measured, rad/m."""
    hazard: float
    """Integral of the hazard; infinite across ground on which all drives fail."""
    cost_m: float
    """Length and the detours that shaking and risk are worth, m; infinite across such ground."""
    barred_m: float
    """Length in tiles that are not passable."""
    unknown_m: float
    """Length in tiles without C_r."""
    obstacle_m: float
    """Length in tiles that hold an obstacle."""

    @property
    def p_arrives(self) -> float:
        """``exp(-hazard)``."""
        return math.exp(-self.hazard)


def tile_cost(field: TileField) -> Floats:
    """Return the cost per metre of each tile at the weights of the map, (rows, cols); infinite where barred."""
    with np.errstate(invalid="ignore"):
        cost = field.rule.cost(field.c_r.astype(np.float64), field.rule.hazard(field.p_fail))
    return np.where((field.barred == Barred.NO) & np.isfinite(cost), cost, np.inf)


def cut_at_tiles(line: Floats) -> TilePieces:
    """Cut a line at the borders of tiles.

    Parameters
    ----------
    line : array (n, 2)
        Field coordinates of its corners: distance to the south and to the east of the window's corner, tiles. A piece
        along a border belongs to the tile in the south or east of it.
    """
    parts = [_cut_segment(a, b) for a, b in pairwise(line)]
    row, col, length = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return TilePieces(row, col, length)


def _cut_segment(a: Floats, b: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    cuts = [np.array([0.0, 1.0])]
    for start, end in zip(a.tolist(), b.tolist(), strict=True):
        low, high = sorted((start, end))
        borders = np.arange(math.floor(low) + 1, math.ceil(high))
        cuts.append((borders - start) / (end - start) if len(borders) else np.empty(0))
    at = np.unique(np.concatenate(cuts))
    middle = a + (b - a) * ((at[1:] + at[:-1]) / 2)[:, None]
    length = np.diff(at) * math.hypot(*(b - a))
    row, col = np.floor(middle).astype(np.int64).T
    long = length > 0
    return row[long], col[long], length[long]


def predict_line(field: TileField, line: Floats, c_r_raw: NDArray[np.floating]) -> LineFigures:
    """Sum the layers along a line.

    Parameters
    ----------
    field : TileField
    line : array (n, 2)
        Field coordinates; all of it lies in the window.
    c_r_raw : array (rows, cols)
        Prediction without noise correction, rad/m.
    """
    pieces = cut_at_tiles(line)
    at = pieces.row, pieces.col
    length = pieces.length * field.grid.tile_size
    known = np.isfinite(field.c_r[at])
    hazard = np.nan_to_num(field.rule.hazard(field.p_fail[at]), nan=0.0, posinf=np.inf)
    risk = float(hazard @ length)
    c_r, low, high, raw = (
        _mean(band[at], length, known) for band in (field.c_r, field.c_r_low, field.c_r_high, c_r_raw)
    )
    whole = float(length.sum())
    return LineFigures(
        length_m=whole,
        c_r=c_r,
        c_r_low=low,
        c_r_high=high,
        c_r_raw=raw,
        hazard=risk,
        cost_m=whole * (1 + field.rule.ride_weight * c_r) + field.rule.fail_weight * risk,
        barred_m=float(length[field.barred[at] != Barred.NO].sum()),
        unknown_m=float(length[~known].sum()),
        obstacle_m=float(length[field.obstacle[at] > 0].sum()),
    )


def shared_length(line: Floats, other: Floats) -> float:
    """Return the share of a line's length that lies in tiles of another line, 0..1; field coordinates."""
    own, met = cut_at_tiles(line), cut_at_tiles(other)
    tiles = set(zip(met.row.tolist(), met.col.tolist(), strict=True))
    shared = [place in tiles for place in zip(own.row.tolist(), own.col.tolist(), strict=True)]
    return float(own.length[shared].sum() / own.length.sum())


def _mean(values: NDArray[np.floating], length: Floats, known: NDArray[np.bool_]) -> float:
    good = known & np.isfinite(values)
    return float(values[good].astype(np.float64) @ length[good] / length[good].sum()) if good.any() else math.nan
