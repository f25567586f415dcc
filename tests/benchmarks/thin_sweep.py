"""Thin a survey, add noise, rate it as the second pass of a map does, and compare with the drives of an evaluation.

``python tests/benchmarks/thin_sweep.py SURVEY CRS DRIVES.jsonl`` prints the table of the page on thin surveys;
``DRIVES.jsonl`` is the journal that ``bumpymap evaluate`` leaves with the survey's drives.
"""

import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from _tile_trials import thin_points
from numpy.typing import NDArray

from bumpymap.core import (
    NO_CLASS,
    FeatureSettings,
    Georeference,
    PatchStack,
    Reason,
    SilentProgress,
    TextureMap,
    parse_json,
)
from bumpymap.lab.evaluate.rated_survey import MeasuredSurvey, load_survey, open_readers
from bumpymap.patches import measure_thin
from bumpymap.rating import MAX_FAILED_SHARE, THIN_COLUMNS, BlockRating, Calibration, RideModel, rate_thin, thin_columns
from bumpymap.readers import ReadOptions
from bumpytiles import BLOCK_TILES, Grid, TilePoints

Floats = NDArray[np.float64]
_CONDITIONS = ((98.0, 0.0), (50.0, 0.0), (20.0, 0.0), (10.0, 0.0), (6.0, 0.0), (4.0, 0.0), (2.0, 0.0))
_NOISY = ((20.0, 0.02), (10.0, 0.02), (4.0, 0.02), (2.0, 0.02))
_MEAN_DENSITY = 98.0
_FIELDS = tuple(f.name for f in fields(BlockRating))


@dataclass(frozen=True, slots=True)
class ThinRow:
    """Comparison of one thinned survey with drives."""

    tiles: int
    spearman: float
    plain: float
    """The same of the standard deviation of the points about the tile's plane, the plainest measure."""
    error: float
    """Median of abs(ln(C_r / driven C_r))."""
    held: float
    """Share of the 80 % intervals that contain the driven C_r."""
    agree: float
    """Share of neighbouring tiles with the same class."""


@dataclass(frozen=True, slots=True)
class ThinnedSurvey:
    """The rated tiles of a survey as one rectangle."""

    rating: BlockRating
    spread: NDArray[np.float32]
    """(rows, cols) standard deviation of the points about the tile's plane, m."""
    west: int
    """Column of the first tile."""
    south: int
    """Row of the first tile; rows grow to the north."""


def driven_c_r(journal: Path) -> dict[tuple[int, int], float]:
    """Return the mean C_r of the driven tiles, rad/m, by (col, row); tiles on which many drives failed are left out."""
    found = {}
    for line in journal.read_text(encoding="utf-8").splitlines()[1:]:
        record = parse_json(line)
        values = [c for c, end in zip(record["c_r"], record["outcome"], strict=True) if end == "completed"]
        if len(values) >= max(2, (1 - MAX_FAILED_SHARE) * len(record["outcome"])):
            found[tuple(record["patch"])] = float(np.mean(values))
    return found


def rate_thinned(
    survey: MeasuredSurvey, calibration: Calibration, share: float, noise_m: float, seed: int
) -> ThinnedSurvey:  # fmt: skip
    """Rate a survey with a share of its points and noise added to their heights."""
    ride = RideModel(calibration)
    parts = [_first_pass(survey, ride, _worse(points, share, noise_m, seed)) for points in survey.points()]
    tiles = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    west, south = (int(tiles[name].min()) // BLOCK_TILES * BLOCK_TILES - 1 for name in ("col", "row"))
    cols, rows = (
        (int(tiles[name].max()) // BLOCK_TILES + 1) * BLOCK_TILES + 1 - first
        for name, first in (("col", west), ("row", south))
    )
    at = (tiles.pop("row") - south, tiles.pop("col") - west)
    maps = {}
    for name, values in tiles.items():
        nothing = {"class_id": NO_CLASS, "reason": Reason.NO_POINTS}.get(name, np.nan)
        maps[name] = np.full((rows, cols, *values.shape[1:]), nothing, values.dtype)
        maps[name][at] = values
    rated = BlockRating(*(maps[name].copy() for name in _FIELDS))
    for row in range(0, rows - 2, BLOCK_TILES):
        for col in range(0, cols - 2, BLOCK_TILES):
            wide = np.s_[row : row + BLOCK_TILES + 2, col : col + BLOCK_TILES + 2]
            first = BlockRating(*(maps[name][wide] for name in _FIELDS))
            block = rate_thin(maps["thin"][wide], first, maps["coverage"][wide], maps["slope"][wide], calibration)
            for name in _FIELDS:
                getattr(rated, name)[wide][1:-1, 1:-1] = getattr(block, name)
    return ThinnedSurvey(rated, maps["thin"][..., THIN_COLUMNS.index("spread")], west, south)


def _worse(points: TilePoints, share: float, noise_m: float, seed: int) -> TilePoints:
    kept = thin_points(points, share, seed) if share < 1 else points
    rng = np.random.default_rng([seed, int(points.col[0]), int(points.row[0])])
    return replace(kept, upward=kept.upward + noise_m * rng.standard_normal(len(kept.upward)))


def _first_pass(survey: MeasuredSurvey, ride: RideModel, points: TilePoints) -> dict[str, NDArray[np.generic]]:
    patches: PatchStack = survey.measured(points)
    thin = measure_thin(points, patches, survey.features, ground_only=survey.ground_only)
    unseen = TextureMap(np.full((len(patches.col), 4), np.nan, np.float32))
    rated = ride.rate(patches, unseen, Georeference(None))
    columns = thin_columns(thin.pairs, thin.relief_map, patches.count, ride.operator)
    named = {name: getattr(rated, name) for name in _FIELDS if name != "reason"}
    own = {name: getattr(patches, name) for name in ("col", "row", "reason", "coverage", "slope")}
    return named | own | {"thin": columns.reshape(-1, len(THIN_COLUMNS))}


def thin_row(tiles: ThinnedSurvey, driven: Mapping[tuple[int, int], float]) -> ThinRow:
    """Compare rated tiles with drives, rad/m by (col, row)."""
    rating = tiles.rating
    rows, cols = rating.class_id.shape
    inside = {
        (row - tiles.south, col - tiles.west): c_r
        for (col, row), c_r in driven.items()
        if 0 <= row - tiles.south < rows and 0 <= col - tiles.west < cols
    }
    at = tuple(np.array(list(inside), np.int64).reshape(-1, 2).T)
    truth = np.array(list(inside.values()), np.float64)
    c_r, low, high = (values[at].astype(np.float64) for values in (rating.c_r, rating.c_r_low, rating.c_r_high))
    known = np.isfinite(c_r)
    plain = tiles.spread[at][known]
    c_r, low, high, truth = c_r[known], low[known], high[known], truth[known]
    return ThinRow(
        tiles=len(c_r),
        spearman=_spearman(c_r, truth),
        plain=_spearman(plain, truth),
        error=float(np.median(np.abs(np.log(c_r / truth)))),
        held=float(np.mean((low <= truth) & (truth <= high))),
        agree=_agreement(rating.class_id),
    )


def _spearman(values: NDArray[np.floating], truth: Floats) -> float:
    known = np.isfinite(values)
    first, second = (np.argsort(np.argsort(part[known])) for part in (values, truth))
    return float(np.corrcoef(first, second)[0, 1])


def _agreement(class_id: NDArray[np.uint8]) -> float:
    same = both = 0
    for near, far in ((class_id[1:], class_id[:-1]), (class_id[:, 1:], class_id[:, :-1])):
        known = (near != NO_CLASS) & (far != NO_CLASS)
        both += int(known.sum())
        same += int((near == far)[known].sum())
    return same / both if both else float("nan")


def _main(survey: str, crs: str, journal: str) -> None:
    calibration, driven = Calibration.shipped("warthog").without_floor(), driven_c_r(Path(journal))
    print("| Points per m² | Noise added | Tiles driven | Spearman | of the standard deviation alone |", end=" ")
    print("Median error | 80 % interval holds | Neighbours of one class |")
    print("|---|---|---|---|---|---|---|---|")
    readers = open_readers([survey], ReadOptions(crs=crs), local=True)
    with (
        tempfile.TemporaryDirectory() as folder,
        load_survey(readers, "all", Grid(3.0, 15), FeatureSettings(), Path(folder), SilentProgress()) as measured,
    ):
        for density, noise in _CONDITIONS + _NOISY:
            row = thin_row(rate_thinned(measured, calibration, density / _MEAN_DENSITY, noise, 1), driven)
            print(
                f"| {density:g} | {100 * noise:g} cm | {row.tiles} | {row.spearman:.3f} | {row.plain:.3f} | "
                f"{100 * row.error:.0f} % | {100 * row.held:.0f} % | {100 * row.agree:.0f} % |",
                flush=True,
            )


if __name__ == "__main__":
    _main(*sys.argv[1:4])
