"""Rate the same survey with fewer points and compare the classes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NO_CLASS, Progress
from bumpymap.lab.evaluate.chance import chance
from bumpymap.lab.evaluate.subject import MAPPED, Subject, Verdict
from bumpymap.lab.evaluate.survey import MeasuredSurvey
from bumpytiles import TilePoints

__all__ = ["DensityRow", "density_sweep", "thinned"]


@dataclass(frozen=True, slots=True)
class DensityRow:
    """One rating of the survey at one density, against the same rating of the whole survey."""

    rating: str
    density: float
    """Points per m2 that was asked for: the mean over the judged tiles."""
    share_of_points: float
    """That were kept, 0..1."""
    tiles: int
    """Judged tiles of the whole survey."""
    still_judged: float
    """Share of them that can be judged with fewer points."""
    same_class: float
    """Share of those that keep their class."""
    same_by_class: float
    """The same, each class counted alike however many tiles it has: mean over the classes of all points."""
    off_two: float
    """Share of those that move by two classes or more."""
    c_r_ratio: float
    """Median of C_r over that of the whole survey."""
    confidence_kept: float
    """Median confidence of tiles that keep their class; NaN without any."""
    confidence_moved: float
    """Median confidence of those that do not; NaN without any."""


def thinned(points: TilePoints, share: float, seed: int) -> TilePoints:
    """Keep about a share of the points, each by its own random number: what stays, stays at higher densities.

    Points of a tile come in an order of their own, so the chance belongs to the point however it was read. Every tile
    stays, be it without points.
    """
    count = np.diff(points.starts)
    place = np.arange(len(points.easting)) - np.repeat(points.starts[:-1], count)
    kept = chance(seed, np.repeat(points.col, count), np.repeat(points.row, count), place) < share
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
class _Seen:
    """What one rating says of judged tiles, with all points and with few."""

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
        Of its judged tiles, points per m2: what the densities are shares of.
    densities : sequence of float
        Those that the survey does not reach are left out.
    seed : int
    told : Progress
    """
    shares = {density: density / mean_density for density in densities if density < mean_density}
    names = [name for name in MAPPED if name in subject.ratings]
    seen = {(name, density): _Seen([], []) for density in shares for name in names}
    progress.start("thinning blocks of tiles", survey.blocks if shares else 0)
    for points in survey.points() if shares else ():
        patches = survey.measured(points)
        judged = patches.reason == 0
        full = subject.judge(patches, names)
        for density, share in shares.items():
            few = subject.judge(survey.measured(thinned(points, share, seed)), names)
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
