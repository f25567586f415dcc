"""Rate the same survey with fewer points and compare the classes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NO_CLASS, Progress
from bumpymap.lab.evaluate.keyed_random import uniform_by_key
from bumpymap.lab.evaluate.subject import MAPPED, Subject, Verdict
from bumpymap.lab.evaluate.survey import MeasuredSurvey
from bumpytiles import TilePoints

__all__ = ["DensityRow", "density_sweep", "thin_points"]


@dataclass(frozen=True, slots=True)
class DensityRow:
    """One rating of the survey at one density, against the same rating of the whole survey."""

    rating: str
    density: float
    """Requested mean density of the classified tiles, points per m2."""
    share_of_points: float
    """Share of the points that were kept, 0..1."""
    tiles: int
    """Classified tiles of the whole survey."""
    still_judged: float
    """Share of them that can be classified with fewer points."""
    same_class: float
    """Share of those that keep their class."""
    same_by_class: float
    """The mean of the same share over the classes, so that all classes have the same weight."""
    off_two: float
    """Share of those that change by two classes or more."""
    c_r_ratio: float
    """Median ratio of C_r to that of the whole survey."""
    confidence_kept: float
    """Median confidence of tiles that keep their class; NaN without any."""
    confidence_moved: float
    """Median confidence of those that do not; NaN without any."""


def thin_points(points: TilePoints, share: float, seed: int) -> TilePoints:
    """Keep about a share of the points, chosen by a random number per point.

    The random number depends on the tile and the point's position in the canonical order of the tile, so points kept at
    a low density are also kept at higher ones. All tiles are kept, even without points.
    """
    count = np.diff(points.starts)
    place = np.arange(len(points.easting)) - np.repeat(points.starts[:-1], count)
    kept = uniform_by_key(seed, np.repeat(points.col, count), np.repeat(points.row, count), place) < share
    starts = np.concatenate(([0], np.cumsum(kept)))[points.starts]
    return replace(
        points,
        starts=starts,
        easting=points.easting[kept],
        northing=points.northing[kept],
        upward=points.upward[kept],
        flag=points.flag[kept],
    )


@dataclass(slots=True)
class _PairedVerdicts:
    """Results of one rating for classified tiles, with all points and with few."""

    full: list[Verdict]
    few: list[Verdict]


def density_sweep(
    survey: MeasuredSurvey,
    subject: Subject,
    mean_density: float,
    densities: Sequence[float],
    seed: int,
    progress: Progress,
) -> list[DensityRow]:
    """Thin a survey to several densities and rate it again.

    Parameters
    ----------
    survey : MeasuredSurvey
    subject : Subject
    mean_density : float
        Mean over its classified tiles, points per m2.
    densities : sequence of float
        Target densities; those that the survey does not exceed are skipped.
    seed : int
    progress : Progress
    """
    shares = {density: density / mean_density for density in densities if density < mean_density}
    names = [name for name in MAPPED if name in subject.ratings]
    seen = {(name, density): _PairedVerdicts([], []) for density in shares for name in names}
    progress.start("thinning blocks of tiles", survey.blocks if shares else 0)
    for points in survey.points() if shares else ():
        patches = survey.measured(points)
        judged = patches.reason == 0
        full = subject.judge(patches, names)
        for density, share in shares.items():
            few = subject.judge(survey.measured(thin_points(points, share, seed)), names)
            for name in names:
                seen[name, density].full.append(full[name].take(judged))
                seen[name, density].few.append(few[name].take(judged))
        progress.advance(1)
    return [
        _row(name, density, shares[density], Verdict.join(both.full), Verdict.join(both.few))
        for (name, density), both in seen.items()
    ]


def _row(name: str, density: float, share: float, full: Verdict, few: Verdict) -> DensityRow:
    judged = few.class_id != NO_CLASS
    before, after = full.take(judged), few.take(judged)
    away = np.abs(before.class_id.astype(np.int64) - after.class_id)
    return DensityRow(
        rating=name,
        density=density,
        share_of_points=share,
        tiles=len(judged),
        still_judged=float(judged.mean()),
        same_class=_share(away == 0),
        same_by_class=_share(np.array([np.mean(away[before.class_id == k] == 0) for k in np.unique(before.class_id)])),
        off_two=_share(away > 1),
        c_r_ratio=_median(after.c_r / before.c_r),
        confidence_kept=_median(after.confidence[away == 0]),
        confidence_moved=_median(after.confidence[away > 0]),
    )


def _share(right: NDArray[Any]) -> float:
    return float(right.mean()) if len(right) else float("nan")


def _median(values: NDArray[np.float64]) -> float:
    return float(np.median(values)) if len(values) else float("nan")
