"""The smallest objects that a survey would have shown: standing objects and steps, and how that is said.

*Objects.* Of an object seen from straight above alone, such as a post with a square top, a survey has as many points as
its top takes of the density: a Poisson number. It is found if it has enough of them: the width at which it has, in 95 %
of all places, is `smallest_object`. Where points are uneven the sparser part of a tile counts.

*Steps.* `find_steps` sees steps that exceed the noise and the roughness of the tile; by how much they must to be
found with 95 % depends on the density. Those that the vehicle cannot cross are found in more noise: `smallest_step`.

Both rest on constants that were fitted to what the whole pipeline finds in made-up surveys.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bumpymap.core.errors import share_text
from bumpymap.core.types import Floats

OBSTACLE_SHARE = 0.02
"""Share of a neighbourhood's points that makes an obstacle: at 100 points/m2 and more a bird has more than one."""
_LEAST_POINTS = 2
"""Points that make an obstacle, at least."""
_NEIGHBOURHOOD = 9.0
"""Pixels in which they lie."""
_QUANTILE = 1.75
"""Of 96 %, in standard deviations: 1 % of the posts has its points in pixels that are no neighbours."""
_ONE_IS_ENOUGH = 4.74
"""Points on the top of an object with which, in 95 % of the cases, it has two of them. In surveys of fewer points on a
pixel than ``_THIN`` a single one makes an obstacle, and it takes no more than that."""
_THIN, _THINNER = (0.4, 0.32), 0.2
"""Points on a pixel below which that holds: with classes, and without; and the share of that by which there are more
where it no longer does."""
_IN_RELIEF = 8.6
"""Points on the top of an object that stands out of relief, because all points count as ground: it must raise the mean
height of a pixel."""
_APART, _WIDE_PX = 0.27, (1.5, 2.7)
"""Share of further points that it takes with classes, because points on a wide top are no neighbours, and the widths
between which that grows, pixels."""
_FLAGGED = 3.0
"""A part of a tile is sparser than the whole if it has this number of standard deviations more empty pixels."""
_STEP, _STEP_THIN = 4.2, 30.0
"""A step is found with 95 % if it is this many times the limit of `bumpymap.rating.find_steps`: the first, and the
second over the points/m2."""
_JUMP, _JUMP_NOISE = 1.15, 0.5
"""Or if it is this many times as high as what the vehicle cannot cross, and this many times the limit more."""
_NO_STEP = 3.0
"""Points/m2 below which steps are not found with 95 %, however high."""
MOST_STEP = 10.0
"""Stands for that, m; of steps as high as that, and higher, nothing else is said."""
_FINE, _COARSE, _FINE_TO = 0.01, 0.05, 0.2
"""Sizes are given in whole multiples of these, m: the first up to the third."""
_MOST_CHANCE = 1.0 - 1e-9
"""No chance is written as 100 %."""


def points_needed(density: NDArray[np.floating] | float, pixel_m: float, *, in_relief: bool) -> Floats:
    """Return the points on the top of an object, on average, with which it is found in 95 % of the cases.

    ``density``: points per m2 of the tile; ``pixel_m``: side of a pixel, m; ``in_relief``: all points count as ground,
    so that obstacles are part of the relief.
    """
    density = np.asarray(density, np.float64)
    least = np.maximum(_LEAST_POINTS, np.ceil(OBSTACLE_SHARE * _NEIGHBOURHOOD * pixel_m**2 * density))
    # Wilson and Hilferty (1931): the mean of a Poisson number that is at least that with this probability.
    most = least * (1.0 - 1.0 / (9.0 * least) + _QUANTILE / (3.0 * np.sqrt(least))) ** 3
    if in_relief:
        most = np.maximum(most, _IN_RELIEF)
    else:
        wide = np.sqrt(most / np.maximum(density, 1e-9)) / pixel_m
        most = most * np.interp(wide, _WIDE_PX, (1.0, 1.0 + _APART))
    thin = _THIN[in_relief]
    dense = np.clip((density * pixel_m**2 / thin - 1.0) / _THINNER, 0.0, 1.0)
    return np.asarray(_ONE_IS_ENOUGH + dense * (most - _ONE_IS_ENOUGH))


def smallest_object(
    held: NDArray[np.bool_], count: NDArray[np.integer], tile_size: float, *, in_relief: bool
) -> NDArray[np.float32]:
    """Return the side of the narrowest standing object that tiles would have shown with 95 %.

    ``held`` (n, pixels, pixels): pixels with points; ``count`` (n,): points of each tile, whatever they are of;
    ``tile_size``: m; ``in_relief``: as for `points_needed`. Returns float32 (n,): m, at most the side of a tile;
    infinite without a point.
    """
    pixel_m = tile_size / held.shape[-1]
    density = count / tile_size**2
    needed = points_needed(density, pixel_m, in_relief=in_relief)
    sparse = np.minimum(density, _density_of_sparse_parts(held, count / held.shape[-1] ** 2) / pixel_m**2)
    return np.asarray(np.minimum(np.sqrt(needed / np.maximum(sparse, 1e-9)), tile_size), np.float32)


def _density_of_sparse_parts(held: NDArray[np.bool_], mean: Floats) -> Floats:
    """Return points per pixel of the sparsest of seven parts of tiles; infinite where none is sparser than by chance.

    The parts are the whole and its thirds along rows and columns: points in lines leave more pixels empty than points
    at random, and so does a part with fewer of them. Their number is that of an even survey with as many empty pixels.
    ``mean`` (n,): points per pixel of the tile.
    """
    side = held.shape[1]
    lines = [np.count_nonzero(~held, axis=axis) for axis in (2, 1)]
    ends = np.array([0, side // 3, side - side // 3])
    parts = [lines[0].sum(axis=1, keepdims=True), *(np.add.reduceat(line, ends, axis=1) for line in lines)]
    empty = np.concatenate(parts, axis=1)
    thirds = np.diff([*ends, side]) * side
    pixels = np.concatenate([[side * side], thirds, thirds]).astype(np.float64)
    chance = np.exp(-mean)[:, None]
    # The points of the whole are given, those of a part are a Poisson number.
    spread = pixels * chance * (1.0 - chance)
    spread[:, 0] -= pixels[0] * chance[:, 0] ** 2 * mean
    flagged = empty > pixels * chance + _FLAGGED * np.sqrt(np.maximum(spread, 0.0)) + 0.5
    found = -np.log(np.clip(empty, 0.5, pixels - 0.5) / pixels)
    return np.asarray(np.where(flagged, found, np.inf).min(axis=1))


def smallest_step(
    limit: NDArray[np.floating], density: NDArray[np.floating] | float, closing: float = math.inf
) -> NDArray[np.float32]:
    """Return the lowest step of the ground that would have been found with 95 %, m; NaN where it is not known.

    ``MOST_STEP`` where none would. ``limit``: of `bumpymap.rating.TileSteps`: up to that height steps do not count, m;
    ``density`` (array of the same shape): points per m2 that were measured; ``closing``: least height of a step that
    closes its place, m.
    """
    out_of_noise = limit * (_STEP + _STEP_THIN / np.maximum(density, 1e-9))
    found = np.minimum(np.minimum(out_of_noise, _JUMP * closing + _JUMP_NOISE * limit), MOST_STEP)
    return np.where((density < _NO_STEP) & ~np.isnan(limit), MOST_STEP, found).astype(np.float32)


def density_for(width: float, pixel_m: float, *, in_relief: bool) -> float:
    """Return the points per m2 from which on an even survey shows objects of a width [m] with 95 %."""
    densities = np.geomspace(0.1, 1e5, 4000)
    widths = np.sqrt(points_needed(densities, pixel_m, in_relief=in_relief) / densities)
    return float(densities[np.flatnonzero(widths > width).max(initial=0)])


SEEN_NUMBERS = ("points_per_m2", "smallest_object_m", "smallest_step_m")
"""Names of the numbers of `SeenSizes` in files."""


@dataclass(frozen=True, slots=True)
class SeenSizes:
    """Smallest objects that a survey would have shown with 95 %, of a site or along a way; NaN where not known."""

    density: float = math.nan
    """Points per m2, of any class."""
    object_m: float = math.nan
    """Side of the narrowest standing object, m."""
    step_m: float = math.nan
    """Height of the lowest step of the ground, m."""

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> Self:
        """Read what `record` returned; what is missing is not known."""
        return cls(*(math.nan if record.get(name) is None else float(record[name]) for name in SEEN_NUMBERS))

    @classmethod
    def forecast(cls, density: float, pixel_m: float, *, in_relief: bool) -> Self:
        """Return what an even survey of a density [1/m2] will show; steps depend on its noise too."""
        return cls(density, float(np.sqrt(points_needed(density, pixel_m, in_relief=in_relief) / density)))

    @property
    def sentence(self) -> str:
        """Say it in a sentence; empty if nothing is known."""
        objects = f"objects narrower than {size_text(self.object_m)}" if math.isfinite(self.object_m) else ""
        lower = f" lower than {size_text(self.step_m)}" if self.step_m < 0.99 * MOST_STEP else ""
        steps = "" if math.isnan(self.step_m) else f"steps{lower}"
        small = " and ".join(filter(None, (objects, steps)))
        density = f"{self.density:.0f}" if self.density >= 9.5 else f"{self.density:.1f}"
        return f"At {density} points/m2, {small} are not seen." if small else ""

    @property
    def condition(self) -> str:
        """Return the condition of a chance to arrive."""
        narrower = f"narrower than {size_text(self.object_m)} " if math.isfinite(self.object_m) else ""
        unseen = "" if narrower else " that the survey does not show"
        return f"if nothing {narrower}stands in the way{unseen}"

    def record(self) -> dict[str, Any]:
        """Return the numbers and the sentence for JSON; None where nothing is known."""
        numbers = zip(SEEN_NUMBERS, (self.density, self.object_m, self.step_m), strict=True)
        found = {name: round(value, 3) if math.isfinite(value) else None for name, value in numbers}
        return found | {"seen": self.sentence}


def size_text(size_m: float) -> str:
    """Return a size [m] in words, rounded up."""
    step = _FINE if size_m <= _FINE_TO else _COARSE
    return f"{max(1, math.ceil(round(size_m, 3) / step - 1e-6)) * step:.3g} m"


def chance_text(chance: float, decimals: int = 1, percent: str = "%") -> str:
    """Return a chance to arrive in per cent: what the survey does not show may be in the way, so never as certain."""
    return share_text(min(chance, _MOST_CHANCE), decimals, percent)
