"""Decide, tile by tile, what has changed: the ground first, then the ride over it.

Two surveys of one place never hit the same points, so their heightmaps differ by noise: little on asphalt, decimetres
in scrub. How much is read off the tile's own differences, pixel by pixel, after the offset of both surveys is taken
off:

- Height: the differences are cut off at 1.5 times their usual size, so that no shrub decides. z_height is their mean
  over its standard error, Student's t, as the value of a normal distribution with the same probability.
- Shape: noise of one pixel says nothing about the next, while a rut or a heap covers many. z_shape adds up products of
  differences of pixels one and two apart, taken about their mean, over the root of the sum of their squares.

Both are standard normal if differences are independent and as often up as down, whatever their size in each pixel: no
model of the noise is needed. Tails are taken as those of Student's t with 30 degrees of freedom: two halves of one
survey, between which nothing has changed, give |z| > 3 a little more often than a normal distribution does.

A ride cost may jump although the ground has not moved: a stone lies in or out of a wheel's way, a border step is just
seen or just not. So a change of the ride counts only where the heights say, by themselves, that the ground has changed.
There alone it is tested, and what the ride cost does by chance is read off the ground that has not changed: intervals
hold errors that both surveys make alike. "As before" is a finding too: the ratio is bounded. What is neither is open.
"""

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtr

from bumpymap.layers import NORMAL_80, SurveyPair
from bumpytiles import TileWindow

Floats = NDArray[np.float64]
_FREEDOM = 30.0
"""Degrees of freedom of the tails."""
_NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


def two_sided(z: Floats) -> Floats:
    """Return the probability of a value at least as far from 0, any shape; NaN stays NaN."""
    return np.asarray(2.0 * stdtr(_FREEDOM, -np.abs(z)), dtype=np.float64)


def upper_sided(z: Floats) -> Floats:
    """Return the probability of a value at least as large, any shape; NaN stays NaN."""
    return np.asarray(stdtr(_FREEDOM, -z), dtype=np.float64)


def widening(z: Floats) -> float:
    """Return by how much the spread behind z is too narrow, at least 1.

    Most ground of a site is as it was. If the middle half of all z is wider than that of a normal distribution, the
    surveys differ by more than their noise: flights that do not fit each other, plants that have grown.

    Parameters
    ----------
    z : array
        One value a tile; NaN is left out.
    """
    known = z[np.isfinite(z)]
    if not len(known):
        return 1.0
    return max(1.0, _NORMAL_MAD * float(np.median(np.abs(known - np.median(known)))))


def hold_false_discoveries(probability: Floats, share: float) -> NDArray[np.bool_]:
    """Choose what counts as found, so that on average at most ``share`` of it is chance.

    The step-up rule of Benjamini and Hochberg (1995, J. R. Stat. Soc. B 57): of n probabilities in rising order, the
    first k are found, k the last whose probability is at most share k / n. It holds for tests that are independent, and
    for neighbouring tiles, whose errors go together (Benjamini and Yekutieli 2001, Ann. Stat. 29).

    ``probability``: of each test, if nothing has changed; NaN: not tested; ``share``: 0..1.
    """
    tested = np.isfinite(probability)
    rising = np.sort(probability[tested])
    below = np.flatnonzero(rising <= share * np.arange(1, len(rising) + 1) / max(len(rising), 1))
    limit = rising[below[-1]] if len(below) else -1.0
    return np.asarray(tested & (np.nan_to_num(probability, nan=2.0) <= limit))


_STRIP_PIXELS = 1 << 20
"""Most pixels that are compared at once."""
_LEAST_SIDE = 5
"""Fewest cells along a tile."""


def cell_pixels(pair: SurveyPair, shared: NDArray[np.bool_], coverage: NDArray[np.floating]) -> int:
    """Return how many pixels make the side of a cell in which heights are compared.

    The number that leaves most pairs of neighbouring cells that hold points of both: thin surveys are compared in
    squares of several pixels.

    ``shared`` (rows, cols): tiles that both surveys have; ``coverage`` (rows, cols): share of the pixels that hold
    points of both, if they fell at random: the product of both coverages.
    """
    pixels = pair.before.grid.pixels
    factors = [factor for factor in range(1, pixels // _LEAST_SIDE + 1) if pixels % factor == 0]
    seen = float(np.nanmedian(coverage[shared])) if shared.any() else 1.0
    return max(factors, key=lambda factor: (1.0 - (1.0 - seen) ** (factor**2)) / factor)


def height_offset(pair: SurveyPair, cell: int) -> float:
    """Return the median, over the tiles, of the median height difference of a tile, m; NaN if none can be compared."""
    middles = []
    for _, difference in _differences(pair, cell):
        enough = np.isfinite(difference).sum(axis=(1, 2)) >= LEAST_CELLS
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # tiles without a value
            middles.append(np.nanmedian(difference[enough], axis=(1, 2)))
    found = np.concatenate(middles)
    return float(np.median(found)) if len(found) else float("nan")


@dataclass(frozen=True, slots=True)
class GroundChange:
    """Differences between the heightmaps of tiles; NaN where too few pixels are seen in both."""

    d_height: Floats
    """(n,) mean difference of the heights, m."""
    z_height: Floats
    """(n,) evidence for another height; standard normal without a change."""
    z_shape: Floats
    """(n,) evidence for another shape, large if there is one; standard normal without a change."""


def ground_changes(pair: SurveyPair, cell: int, offset: float) -> GroundChange:
    """Compare the heights of all tiles of the common window; arrays are (rows, cols), north row first."""
    window = pair.window
    out = [np.full((window.rows, window.cols), np.nan) for _ in range(3)]
    for rows, difference in _differences(pair, cell):
        found = compare_heights(difference - offset)
        parts: Any = (found.d_height, found.z_height, found.z_shape)
        for array, values in zip(out, parts, strict=True):
            array[rows] = values.reshape(-1, window.cols)
    return GroundChange(*out)


def _differences(pair: SurveyPair, cell: int) -> Iterator[tuple[slice, NDArray[np.float64]]]:
    """Yield rows of the common window, north first, and the difference of their heights, (tiles, cells, cells), m."""
    window, pixels = pair.window, pair.before.grid.pixels
    step = max(1, _STRIP_PIXELS // (window.cols * pixels**2))
    for top in range(0, window.rows, step):
        rows = slice(top, min(top + step, window.rows))
        south = window.row + window.rows - rows.stop
        strip = TileWindow(window.col, south, window.cols, rows.stop - rows.start)
        before, after = (coarsen(side.reshape(-1, pixels, pixels), cell) for side in pair.heights(strip))
        yield rows, after - before


_LEAST_OWN = 0.5
"""Least share of a spread that is the survey's own."""


Bands = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]


@dataclass(frozen=True, slots=True)
class CommonError:
    """Error that two maps with one calibration share: it changes no ride cost between them."""

    model_error: float = 0.0
    """Standard deviation of ln C_r by which the ride model may be off; 0 of maps whose intervals do not hold it."""
    floor: float = 0.0
    """Ride cost of even ground, rad/m: it is in ``c_r`` in power, but not in the model."""

    @classmethod
    def of(cls, manifest: Mapping[str, Any]) -> "CommonError":
        """Read what run.json says of the calibration."""
        known = manifest.get("calibration")
        found = known if isinstance(known, Mapping) else {}
        return cls(*(_number(found.get(name)) for name in ("model_error", "floor_radpm")))

    def log_sd(self, c_r: Floats) -> Floats:
        """Return its standard deviation in ln c_r, of ride costs [rad/m] of any shape."""
        of_ground = np.clip(1.0 - (self.floor / c_r) ** 2, 0.0, 1.0) if self.floor else np.ones_like(c_r)
        return self.model_error * of_ground


@dataclass(frozen=True, slots=True)
class RideChange:
    """Differences of ln c_r, after minus before; NaN where one of the two is unknown or not positive."""

    log_ratio: Floats
    """Any shape."""
    sd: Floats
    """Combined spread of both, of the same shape."""

    @classmethod
    def of(cls, before: Bands, after: Bands, common: CommonError | None = None) -> "RideChange":
        """Compare ``c_r``, ``c_r_low`` and ``c_r_high`` [rad/m]; the spreads are those of the 80 % intervals of ln c_r.

        ``common``: taken off both spreads.
        """
        shared = common or CommonError()
        with np.errstate(divide="ignore", invalid="ignore"):
            (first, of_first), (second, of_second) = (_log_and_spread(bands, shared) for bands in (before, after))
            ratio, sd = second - first, np.hypot(of_first, of_second)
            known = np.isfinite(ratio / sd)
        return cls(np.where(known, ratio, np.nan), np.where(known, sd, np.nan))


def _log_and_spread(bands: Bands, common: CommonError) -> tuple[Floats, Floats]:
    """Return ln c_r and the standard deviation of the survey's own error in it, the mean of both sides."""
    c_r, low, high = (band.astype(np.float64) for band in bands)
    middle = np.log(c_r)
    shared = common.log_sd(c_r)
    sides = ((middle - np.log(low)) / NORMAL_80, (np.log(high) - middle) / NORMAL_80)
    below, above = (np.sqrt(np.maximum(side**2 - shared**2, (_LEAST_OWN * side) ** 2)) for side in sides)
    return middle, 0.5 * (below + above)


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) and 0.0 <= value < np.inf else 0.0


LEAST_CELLS = 16
"""Fewest pixels that both surveys have seen, for a tile to be compared."""
_CUT = 1.5
"""Where differences are cut off, in standard deviations."""
_FLOOR_M = 1e-3
"""Least standard deviation of the differences, m: heights are stored to a millimetre."""
_EXACT, _MOST_T = 1e-9, 100.0
"""Differences that are all alike leave no error: their t is limited."""
_LAGS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))
"""Pairs of pixels of z_shape: rows and columns between them."""


def coarsen(heights: NDArray[np.floating], factor: int) -> Floats:
    """Return means over squares of ``factor`` x ``factor`` pixels, (n, p, p) -> (n, p / factor, p / factor).

    NaN where a square has no height.
    """
    n, side, _ = heights.shape
    parts = heights.astype(np.float64).reshape(n, side // factor, factor, side // factor, factor)
    count = np.isfinite(parts).sum(axis=(2, 4))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.nansum(parts, axis=(2, 4)) / np.where(count > 0, count, np.nan))


def compare_heights(difference: Floats) -> GroundChange:
    """Compare the heightmaps of tiles.

    ``difference`` (n, p, p): later minus earlier height of each pixel, m, the common offset taken off; NaN where one
    has none.
    """
    count = np.isfinite(difference).sum(axis=(1, 2))
    enough = count >= LEAST_CELLS
    values = np.where(enough[:, None, None], difference, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # tiles without a value
        mean = np.nanmean(values, axis=(1, 2))
        middle = np.nanmedian(values, axis=(1, 2))[:, None, None]
        level, form = _cut_off(values), _cut_off(values - middle)
        form -= np.nanmean(form, axis=(1, 2))[:, None, None]
    sums = np.nansum(level, axis=(1, 2)), np.nansum(level * level, axis=(1, 2))
    height, shape = _student(_ratio(*sums), count), _ratio(*_products(form))
    return GroundChange(*(np.where(enough, found, np.nan) for found in (mean, height, shape)))


def _cut_off(values: Floats) -> Floats:
    """Divide by the standard deviation, from the median of the sizes, and cut off what is larger than ``_CUT``."""
    spread = _NORMAL_MAD * np.nanmedian(np.abs(values), axis=(1, 2))[:, None, None]
    return np.clip(values / np.maximum(spread, _FLOOR_M), -_CUT, _CUT)


def _products(form: Floats) -> tuple[Floats, Floats]:
    """Return the sums of the products of all pairs of pixels, and of their squares."""
    side = form.shape[1]
    total, square = np.zeros(len(form)), np.zeros(len(form))
    for down, right in _LAGS:
        first = form[:, down:, max(right, 0) : side + min(right, 0)]
        second = form[:, : side - down, max(-right, 0) : side - max(right, 0)]
        product = first * second
        total += np.nansum(product, axis=(1, 2))
        square += np.nansum(product * product, axis=(1, 2))
    return total, square


def _student(ratio: Floats, count: NDArray[np.int64]) -> Floats:
    """Return the normal equivalent of Student's t, which follows from sum over root of the sum of squares."""
    n = np.maximum(count, 2)
    t = np.minimum(np.abs(ratio) * np.sqrt((n - 1) / np.maximum(n - ratio**2, _EXACT * n)), _MOST_T)
    return np.asarray(-np.sign(ratio) * ndtri(stdtr(n - 1, -t)))


def _ratio(total: Floats, square: Floats) -> Floats:
    """Return sum over root of the sum of squares; 0 where nothing differs."""
    return np.asarray(total / np.sqrt(np.where(square > 0.0, square, 1.0)))


_AS_BEFORE, _ROUGHER, _SMOOTHER, _UNKNOWN, _OPEN = range(1, 6)
_FEW = 100
"""Fewer unchanged tiles tell no spread of the ride cost: that of the intervals is taken."""
SAME_RIDE = 1.5
"""Most ratio of two ride costs that are alike."""


@dataclass(frozen=True, slots=True)
class Decision:
    """Changes by tile. Arrays are (rows, cols)."""

    z_height: Floats
    """Widened; NaN where not compared (so are the next)."""
    z_shape: Floats
    z_c_r: Floats
    code: Floats
    """Position in ``CHANGE_KINDS``."""
    widened: dict[str, float]
    """Spread of each z over the expected one: at least 1, of the ride cost at least one half."""


def decide(ground: GroundChange, ride: RideChange, fdr: float) -> Decision:
    """Find the tiles that have changed.

    ``ground``, ``ride``: of all tiles, (rows, cols); ``fdr``: share of false discoveries, for the ground and again for
    the ride.
    """
    widened = {"height": widening(ground.z_height), "shape": widening(ground.z_shape)}
    height = ground.z_height / widened["height"]
    # What all tiles have in common is no change of any: a shift of one survey makes every shape differ a little.
    known = ground.z_shape[np.isfinite(ground.z_shape)]
    common = max(0.0, float(np.median(known))) if len(known) else 0.0
    shape = (ground.z_shape - common) / widened["shape"]
    of_ground = np.minimum(1.0, 2.0 * np.fmin(two_sided(height), upper_sided(shape)))
    moved = hold_false_discoveries(of_ground, fdr)
    z = ride.log_ratio / ride.sd
    still = np.abs(z[np.isfinite(z) & np.isfinite(of_ground) & ~moved])
    usual = _NORMAL_MAD * float(np.median(still)) if len(still) else 1.0
    widened["c_r"] = max(usual, 1.0 if len(still) < _FEW else _LEAST_OWN)
    z = z / widened["c_r"]
    rides = hold_false_discoveries(np.where(moved, two_sided(z), np.nan), fdr)
    bounded = np.abs(ride.log_ratio) + NORMAL_80 * widened["c_r"] * ride.sd <= np.log(SAME_RIDE)
    code = np.where(moved, np.where(bounded, _AS_BEFORE, _OPEN), 0).astype(np.float64)
    code[moved & np.isnan(z)] = _UNKNOWN
    code[rides] = np.where(z[rides] > 0.0, _ROUGHER, _SMOOTHER)
    code[np.isnan(of_ground)] = np.nan
    return Decision(height, shape, z, code, widened)
