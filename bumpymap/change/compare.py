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

False discoveries and robust spreads are counted here, in no more lines than a call of `scipy.stats` takes: importing it
takes 0.8 s, of 4.6 s for the whole comparison of `sample_data/quarry.laz` with itself.
"""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtr

from bumpymap.core import NORMAL_80, Floats, tiles_of
from bumpymap.layers import SurveyPair
from bumpytiles import TileWindow

_FREEDOM = 30.0
"""Degrees of freedom of the tails, chosen: see above."""
_NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation: 1 / 0.6745, the 75 % quantile."""


def two_sided(z: Floats) -> Floats:
    """Return the probability of a value at least as far from 0, any shape; NaN stays NaN."""
    return np.asarray(2.0 * stdtr(_FREEDOM, -np.abs(z)), dtype=np.float64)


def widening(z: Floats) -> float:
    """Return by how much the spread behind z is too narrow, at least 1.

    Most ground of a site is as it was. If the middle half of all z is wider than that of a normal distribution, the
    surveys differ by more than their noise: flights that do not fit each other, plants that have grown. ``z``: one
    value a tile; NaN is left out.
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
"""Most pixels that are compared at once, chosen: 8 MB for each array."""
_LEAST_SIDE = 5
"""Fewest cells along a tile: chosen."""


def cell_pixels(pair: SurveyPair, shared: NDArray[np.bool_], coverage: NDArray[np.floating]) -> int:
    """Return the number of pixels along the side of a cell in which heights are compared.

    The number that leaves most pairs of neighbouring cells that hold points of both: thin surveys are compared in
    squares of several pixels.

    ``shared`` (rows, cols): tiles that both surveys have; ``coverage`` (rows, cols): share of the pixels that hold
    points of both, if they fell at random: the product of both coverages.
    """
    pixels = pair.before.grid.pixels
    factors = [factor for factor in range(1, max(pixels // _LEAST_SIDE, 1) + 1) if pixels % factor == 0]
    seen = float(np.nanmedian(coverage[shared])) if shared.any() else 1.0
    return max(factors, key=lambda factor: (1.0 - (1.0 - seen) ** (factor**2)) / factor)


@dataclass(frozen=True, slots=True)
class Registration:
    """How the later survey lies to the earlier one: in plan and tilted. Zeros where nothing is taken off it."""

    shift_m: Floats
    """(2,) eastwards and northwards."""
    tilt: Floats
    """(2,) rise of the difference per metre eastwards and northwards."""
    found_shift_m: Floats
    """(2,) as measured; NaN if the ground has too little relief to tell."""
    shift_sd_m: Floats
    """(2,)"""
    found_tilt: Floats
    """(2,) as measured; NaN if it is not known."""
    tilt_sd: float
    """Of its steeper direction."""
    stable: int
    """Tiles that it rests on."""


_NOT_KNOWN = np.full(2, np.nan)
NOT_REGISTERED = Registration(np.zeros(2), np.zeros(2), _NOT_KNOWN, _NOT_KNOWN, _NOT_KNOWN, float("nan"), 0)
"""It takes nothing off."""


def register(pair: SurveyPair, shared: NDArray[np.bool_], cell: int) -> Registration:
    """Find how the later survey is shifted in plan and tilted, from ground that has not changed.

    A shift d makes heights differ by -d times the gradient of the ground (Nuth and Kaab 2011, The Cryosphere 5, in
    its linear form), a tilt by a plane. Both are found by weighted least squares over all cells of a sample of tiles,
    again from where whole pixels of the shift put the later survey. A noisy gradient would make shifts too small, so
    that of one survey is the instrument for that of the other: their noise is independent. Cells that lie far off
    count less (Huber), and tiles whose median lies far off have changed and count for nothing.

    What is not clearly above its own standard error, from sums over blocks of tiles, is not taken off.

    ``shared`` (rows, cols): tiles that both surveys have; ``cell``: from `cell_pixels`.
    """
    blocks = _sample(pair, shared)
    coarse = 3 if pair.before.grid.pixels % 3 == 0 and pair.before.grid.pixels >= 3 * _LEAST_SIDE else cell
    found, both = np.zeros(5), np.ones(5, np.bool_)
    fit = _fit_plane(pair, blocks, max(cell, coarse), found, both, _ROUNDS // 2)
    if fit is not None and fit[2] > _LEAST_RELIEF:
        fit = _fit_plane(pair, blocks, cell, fit[0], both, _ROUNDS)
    shift, shift_sd = np.full(2, np.nan), np.full(2, np.nan)
    is_sure = False
    if fit is not None and fit[2] > _LEAST_RELIEF:
        values, covariance, _, _ = fit
        sd = np.sqrt(np.diag(covariance)[3:])
        if (sd < _MOST_SHIFT_SD_M).all() and (np.abs(values[3:]) < _MOST_SHIFT_M).all():
            shift, shift_sd = values[3:], sd
            is_sure = _is_sure(shift, covariance[3:, 3:])
            if is_sure:
                shift_sd = np.hypot(sd, _BETWEEN * pair.cell_m(1))
    if not is_sure:
        both[3:] = False
        fit = _fit_plane(pair, blocks, cell, found, both, _ROUNDS)
    if fit is None:
        return NOT_REGISTERED
    values, covariance, _, stable = fit
    tilt, of_tilt = values[1:3], covariance[1:3, 1:3]
    none = np.zeros(2)
    return Registration(
        shift if is_sure else none,
        tilt if _is_sure(tilt, of_tilt) else none,
        shift,
        shift_sd,
        tilt,
        float(np.sqrt(np.linalg.eigvalsh(of_tilt)[-1])),
        stable,
    )


_BLOCK, _MOST_BLOCKS = 4, 128
"""Tiles along a block of the sample, and most blocks: chosen."""
_ROUNDS = 12
"""Most rounds of the fit, chosen; `_CLOSE` ends it earlier."""
_LEAST_RELIEF = 5.0
"""Common part of both gradients over its standard error, in the direction that has least: less tells no shift."""
_MOST_SHIFT_SD_M, _MOST_SHIFT_M = 0.05, 2.0
"""A shift whose standard error, m, or size, m, is larger is not believed: chosen."""
_BETWEEN = 0.05
"""Error of a shift between two whole pixels, in pixels: 9 mm on a lava field."""
_SURE = 13.8
"""Chi squared of two unknowns that noise exceeds once in a thousand."""
_HUBER, _TRIM = 1.5, 3.0
"""Standard deviations from which a cell counts less (Huber's usual 1.345, rounded), and a tile for nothing."""
_FEW_BLOCKS = 30
"""Fewer blocks tell no standard error: that from tiles is taken."""


_PlaneFit: TypeAlias = tuple[Floats, Floats, float, int]
"""(5,) height, rise eastwards and northwards, shift eastwards and northwards; their covariance; the relief that tells a
shift, see `_LEAST_RELIEF`; tiles that count."""


def _is_sure(values: Floats, covariance: Floats) -> bool:
    return bool(values.any() and values @ np.linalg.pinv(covariance) @ values > _SURE)


_Block: TypeAlias = tuple[TileWindow, NDArray[np.float32], NDArray[np.float32]]
"""Tiles, and the heights of both surveys in them and one tile around."""


def _sample(pair: SurveyPair, shared: NDArray[np.bool_]) -> list[_Block]:
    """Read blocks of tiles that both surveys have, evenly spread."""
    window = pair.window
    rows, cols = -(-window.rows // _BLOCK), -(-window.cols // _BLOCK)
    room = np.zeros((rows * _BLOCK, cols * _BLOCK), np.bool_)
    room[: window.rows, : window.cols] = shared
    filled = np.flatnonzero(room.reshape(rows, _BLOCK, cols, _BLOCK).any(axis=(1, 3)).ravel())
    chosen = filled[np.unique(np.linspace(0, len(filled) - 1, _MOST_BLOCKS).round().astype(np.int64))]
    top = window.row + window.rows
    windows = (
        TileWindow(window.col + _BLOCK * (one % cols), top - _BLOCK * (one // cols + 1), _BLOCK, _BLOCK)
        for one in chosen.tolist()
    )
    return [(one, *pair.heights(one.grown(1))) for one in windows]


def _fit_plane(
    pair: SurveyPair, blocks: list[_Block], cell: int, begin: Floats, fitted: NDArray[np.bool_], rounds: int
) -> _PlaneFit | None:
    """Fit height, tilt and shift; None if too few cells can be compared. ``fitted`` (5,): which of them."""
    values, pixel = begin.copy(), pair.cell_m(1)
    limit, names = np.inf, np.flatnonzero(fitted)
    whole, layers, block = np.full(2, np.nan), np.empty(0), np.empty(0, np.int64)
    for _ in range(rounds):
        if not (np.abs(values[3:] - whole) <= _STAY * pixel).all():
            whole = np.round(values[3:] / pixel) * pixel
            layers, block = _layers(pair, blocks, cell, whole)
        middle, used, normal, right = _sums(layers, np.concatenate([values[:3], values[3:] - whole]), limit)
        solved = _solve(normal, right, names)
        if solved is None:
            return None
        rest, inverse = solved
        before, values = values, np.clip(rest + np.concatenate([np.zeros(3), whole]), -_ENDS, _ENDS)
        settled, limit = np.isfinite(limit), _TRIM * max(_NORMAL_MAD * float(np.median(np.abs(middle))), _FLOOR_M)
        if settled and (np.abs(values - before) < _CLOSE).all():
            break
    beyond = whole + pixel * np.sign(rest[3:])
    if (beyond != whole).any():  # gradients of cells are smoother than the ground: what is left is between two moves
        after_it = _layers(pair, blocks, cell, beyond)[0]
        solved = _solve(*_sums(after_it, np.concatenate([values[:3], values[3:] - beyond]), limit)[2:], names)
        if solved is not None and (solved[0][3:] * rest[3:] <= 0.0).all():
            apart = rest[3:] - solved[0][3:]
            values[3:] = whole + (beyond - whole) * rest[3:] / np.where(apart == 0.0, 1.0, apart)
    left = (right - normal @ rest)[:, names]
    if block[-1] >= _FEW_BLOCKS:
        left = np.stack([np.bincount(block, weights=one) for one in left.T], axis=1)
    covariance = np.zeros((5, 5))
    covariance[np.ix_(names, names)] = inverse @ (left.T @ left) @ inverse
    relief = normal[:, 3:, 3:]
    direction = np.linalg.eigh(relief.sum(axis=0))[1][:, 0]
    common = np.einsum("i,nij,j->n", direction, relief, direction)
    return values, covariance, float(common.sum() / max(np.sqrt((common**2).sum()), 1e-12)), int(used.sum())


def _solve(normal: Floats, right: Floats, names: NDArray[np.int64]) -> tuple[Floats, Floats] | None:
    """Return the unknowns (5,), and the inverse of the matrix of those ``names``; None if they are not determined."""
    matrix, values = normal.sum(axis=0)[np.ix_(names, names)], np.zeros(5)
    if np.linalg.matrix_rank(matrix, hermitian=True) < len(names):
        return None
    values[names] = np.linalg.solve(matrix, right.sum(axis=0)[names])
    return values, np.linalg.inv(matrix)


_STAY = 0.6
"""Shift left over, in pixels, from which the later survey is moved anew: more than one half, or it goes to and fro."""
_CLOSE = np.array([1e-4, 1e-7, 1e-7, 1e-4, 1e-4])
"""A step that is smaller, m and m/m, is the last one."""
_ENDS = np.array([np.inf, np.inf, np.inf, 1.5 * _MOST_SHIFT_M, 1.5 * _MOST_SHIFT_M])
"""Largest size of each unknown on the way to the fit."""


def _layers(pair: SurveyPair, blocks: list[_Block], cell: int, whole: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Return what a fit needs of each cell, tile by tile, and the number of the block of each tile.

    Returns (n, cells, 7): east and north of the middle, m, both gradients (eastwards, northwards) of the earlier and
    of the later survey, and the difference of the heights, m; and (n,). Tiles with too few cells are left out.
    """
    side = pair.before.grid.pixels // cell
    parts, numbers = [], []
    for number, (block, *heights) in enumerate(blocks):
        first, second = _cells(pair, heights, cell, whole)
        slopes = (*_gradient(first, pair.cell_m(cell)), *_gradient(second, pair.cell_m(cell)))
        inner = [one[side:-side, side:-side] for one in (*slopes, second - first)]
        place = [np.broadcast_to(one, inner[0].shape) for one in _middles(pair, block, cell)]
        found = np.stack([tiles_of(one, side) for one in (*place, *inner)], axis=-1).reshape(-1, side**2, 7)
        enough = np.isfinite(found).all(axis=-1).sum(axis=1) >= LEAST_CELLS
        parts.append(found[enough])
        numbers.append(np.full(int(enough.sum()), number))
    return np.concatenate(parts), np.concatenate(numbers)


def _sums(layers: Floats, at: Floats, limit: float) -> tuple[Floats, NDArray[np.bool_], Floats, Floats]:
    """Return of each tile the median residual, m, whether it counts, and its normal equations: (n, 5, 5), (n, 5)."""
    known = np.asarray(np.isfinite(layers).all(axis=-1))
    layers = np.where(known[:, :, None], layers, 0.0)
    plane = [np.ones_like(layers[:, :, :1]), layers[:, :, :2]]
    own, other = (np.concatenate([*plane, -layers[:, :, first : first + 2]], axis=-1) for first in (2, 4))
    residual = np.where(known, layers[:, :, 6] - 0.5 * (own + other) @ at, np.nan)
    middle = _median(residual)
    spread = np.maximum(_NORMAL_MAD * _median(np.abs(residual - middle[:, None])), _FLOOR_M)[:, None]
    used = np.abs(middle) <= limit
    near = np.minimum(1.0, _HUBER * spread / np.maximum(np.abs(residual), 1e-12))
    weight = np.where(known & used[:, None], near / spread**2, 0.0)[:, :, None]
    normal = np.swapaxes(own * weight, 1, 2) @ other
    # Not the residual: its gradient has the noise of the instrument.
    right = (0.5 * (own + other) * weight * layers[:, :, 6:]).sum(axis=1)
    return middle, used, 0.5 * (normal + np.swapaxes(normal, 1, 2)), right


def _median(values: Floats) -> Floats:
    """Return the median of each row, (n, m) -> (n,), NaN left out; each has a value. 20 times as fast as nanmedian."""
    ranked, count = np.sort(values, axis=1), np.isfinite(values).sum(axis=1)
    row = np.arange(len(values))
    return np.asarray(0.5 * (ranked[row, (count - 1) // 2] + ranked[row, count // 2]))


def _middles(pair: SurveyPair, window: TileWindow, cell: int) -> tuple[Floats, Floats]:
    """Return how far the cells of a window lie east (1, cols) and north (rows, 1) of the middle of the surveys, m."""
    size, side = pair.before.grid.tile_size, pair.before.grid.pixels // cell
    west = window.col - (pair.window.col + 0.5 * pair.window.cols)
    top = window.row + window.rows - (pair.window.row + 0.5 * pair.window.rows)
    east, south = ((np.arange(count * side) + 0.5) / side for count in (window.cols, window.rows))
    return size * (west + east)[None, :], size * (top - south)[:, None]


def _cells(
    pair: SurveyPair, heights: Sequence[NDArray[np.float32]], cell: int, shift_m: Floats
) -> tuple[Floats, Floats]:
    """Return the heights of both surveys in cells, the later one moved back by the whole pixels of a shift."""
    before, after = heights
    east, north = np.round(shift_m / pair.cell_m(1)).astype(np.int64).tolist()
    if east or north:
        pad = max(abs(east), abs(north))
        wide = np.pad(after, pad, constant_values=np.nan)
        after = wide[pad - north : pad - north + len(after), pad + east : pad + east + after.shape[1]]
    return _coarsen(before, cell), _coarsen(after, cell)


def _gradient(heights: Floats, size: float) -> tuple[Floats, Floats]:
    """Return the rise eastwards and northwards, m/m, from the three cells on either side of each; NaN at the edge.

    The cell itself does not count, so that its error is none of the gradient's.
    """
    out = []
    for z in (heights, heights.T):
        wide = np.pad(z, 1, constant_values=np.nan)
        rows = np.stack([wide[:-2], wide[1:-1], wide[2:]])
        count = np.isfinite(rows).sum(axis=0)
        line = np.nansum(rows, axis=0) / np.where(count > 0, count, np.nan)
        out.append((line[:, 2:] - line[:, :-2]) / (2.0 * size))
    return out[0], -out[1].T


def height_offset(pair: SurveyPair, cell: int, registration: Registration) -> float:
    """Return the median, over the tiles, of the median height difference of a tile, m; NaN if none can be compared."""
    middles = []
    for difference in _differences(pair, cell, registration):
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
    d_largest: Floats
    """(n,) difference farthest from 0 that two neighbouring pixels both reach, m; 0 if no two have the same sign."""
    z_height: Floats
    """(n,) evidence for another height; standard normal without a change."""
    z_shape: Floats
    """(n,) evidence for another shape, large if there is one; standard normal without a change."""
    sd_height: Floats
    """(n,) standard deviation of the mean difference, by the spread of the tile's differences, m."""
    least_height: Floats
    """(n,) mean height of the smallest heap or pit that would have counted alone in 95 of 100 cases, m; infinite where
    too few cells were seen for any."""


SURE = 5.5
"""From this evidence on a tile counts alone. Chosen: on unchanged halves of a survey (lava, scrub, asphalt; 53, 10 and
4 points per m2; 27,700 tiles) the largest was 4.5."""
_HEAP_SD = 0.3
"""Standard deviation of the normal profile of a heap over the side of its tile: chosen, one that just fills it."""
_DRAWS, _FOUND = 100, 0.95
"""Draws of noise for each size of a heap, and share of them in which it must be found."""
_HEAPS = np.geomspace(0.2, 30.0, 20)
"""Mean heights of heaps over the spread of the differences of cells, from the first that is tried."""


@lru_cache(maxsize=4)
def _least_heaps(side: int) -> tuple[Floats, Floats]:
    """Return numbers of cells that are seen, of ``side`` x ``side``, and the least heap found in each case, in spreads.

    The heap lies on the middle of the tile; noise of cells is normal.
    """
    random, x = np.random.default_rng(0), (np.arange(side) + 0.5) / side - 0.5
    heap = np.exp(-(x[:, None] ** 2 + x**2) / (2 * _HEAP_SD**2))
    counts = np.unique(np.geomspace(LEAST_CELLS, side**2, 6).astype(np.int64))
    least = np.full(len(counts), np.inf)
    for at, count in enumerate(counts.tolist()):
        noise = random.standard_normal((_DRAWS, side, side))
        noise[random.random((_DRAWS, side**2)).argsort(axis=1).reshape(noise.shape) >= count] = np.nan
        for mean in _HEAPS.tolist():
            found = compare_heights(noise + mean * heap / heap.mean(), judge=False)
            if (np.fmax(np.abs(found.z_height), found.z_shape) >= SURE).mean() >= _FOUND:
                least[at] = mean
                break
    return counts.astype(np.float64), least


def ground_changes(pair: SurveyPair, cell: int, offset: float, registration: Registration) -> GroundChange:
    """Compare the heights of all tiles of the common window; arrays are (rows, cols), north row first."""
    window = pair.window
    parts = [compare_heights(each - offset) for each in _differences(pair, cell, registration)]
    whole = (np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(GroundChange))
    return GroundChange(*(values.reshape(window.rows, window.cols) for values in whole))


def _differences(pair: SurveyPair, cell: int, registration: Registration) -> Iterator[Floats]:
    """Yield the differences of the heights in rows of the common window, north first, (tiles, cells, cells), m.

    Of a shift, whole pixels move the later survey; the rest is taken off by the gradient of the ground, so that the
    noise of neighbouring cells stays independent.
    """
    window, pixels = pair.window, pair.before.grid.pixels
    side, pixel = pixels // cell, pair.cell_m(1)
    step = max(1, _STRIP_PIXELS // (window.cols * pixels**2))
    rest = registration.shift_m - np.round(registration.shift_m / pixel) * pixel
    for _, strip in window.cut(step):
        before, after = _cells(pair, pair.heights(strip.grown(1)), cell, registration.shift_m)
        difference = after - before
        if rest.any():
            slopes = zip(*(_gradient(one, pair.cell_m(cell)) for one in (before, after)), strict=True)
            difference += sum(0.5 * far * (own + other) for far, (own, other) in zip(rest, slopes, strict=True))
        difference = difference[side:-side, side:-side]
        if registration.tilt.any():
            east, north = _middles(pair, strip, cell)
            difference -= registration.tilt[0] * east + registration.tilt[1] * north
        yield tiles_of(difference, side).reshape(-1, side, side)


_LEAST_OWN = 0.5
"""Least share of a spread that is the survey's own, chosen."""
RideSides = tuple[NDArray[np.float32], Floats]
"""``c_r``, rad/m, and the standard deviations of ln c_r below and above it, of `interval_log_sd`."""


def common_error(manifest: Mapping[str, Any]) -> tuple[float, float]:
    """Return the error that two maps with one calibration share, by run.json: it changes no ride cost between them.

    The standard deviation of ln C_r by which the ride model may be off, 0 of maps whose intervals do not hold it; and
    the ride cost of even ground, rad/m, which is in ``c_r`` in power, but not in the model.
    """
    model_error, floor = (manifest["calibration"].get(name) for name in ("model_error", "floor_radpm"))
    known = (each if isinstance(each, int | float) and 0.0 <= each < np.inf else 0.0 for each in (model_error, floor))
    first, second = map(float, known)
    return first, second


def ride_change(before: RideSides, after: RideSides, common: tuple[float, float] = (0.0, 0.0)) -> tuple[Floats, Floats]:
    """Return the differences of ln c_r, after minus before, and their combined spread; NaN where one is not known.

    ``before``, ``after``: of arrays of any shape; ``common``: of `common_error`, taken off both spreads.
    """
    (model_error, floor), logs, spreads = common, [], []
    with np.errstate(divide="ignore", invalid="ignore"):
        for c_r, sides in ((each.astype(np.float64), sides) for each, sides in (before, after)):
            logs.append(np.log(c_r))
            shared = model_error * np.clip(1.0 - (floor / c_r) ** 2, 0.0, 1.0)
            # Of the survey's own error, the mean of both sides.
            spreads.append(np.sqrt(np.maximum(sides**2 - shared**2, (_LEAST_OWN * sides) ** 2)).mean(axis=0))
        ratio, sd = logs[1] - logs[0], np.hypot(*spreads)
        known = np.isfinite(ratio / sd)
    return np.where(known, ratio, np.nan), np.where(known, sd, np.nan)


LEAST_CELLS = 16
"""Fewest pixels that both surveys have seen, for a tile to be compared: chosen."""
_CUT = 1.5
"""Where differences are cut off, in standard deviations: as for Huber's weights."""
_FLOOR_M = 1e-3
"""Least standard deviation of the differences, m: heights are stored to a millimetre."""
_EXACT, _MOST_T = 1e-9, 100.0
"""Differences that are all alike leave no error: least share of the sum of squares that is error, and largest t."""
_LAGS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))
"""Pairs of pixels of z_shape: rows and columns between them."""


def _coarsen(heights: NDArray[np.floating], factor: int) -> Floats:
    """Return means over squares of ``factor`` x ``factor`` pixels, (rows, cols); NaN where a square has no height."""
    rows, cols = (length // factor for length in heights.shape)
    parts = heights.astype(np.float64).reshape(rows, factor, cols, factor)
    count = np.isfinite(parts).sum(axis=(1, 3))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.nansum(parts, axis=(1, 3)) / np.where(count > 0, count, np.nan))


def compare_heights(difference: Floats, *, judge: bool = True) -> GroundChange:
    """Compare the heightmaps of tiles.

    ``difference`` (n, p, p): later minus earlier height of each pixel, m, the common offset taken off; NaN where one
    has none; ``judge``: find ``least_height`` too.
    """
    count = np.isfinite(difference).sum(axis=(1, 2))
    enough = count >= LEAST_CELLS
    values = np.where(enough[:, None, None], difference, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # tiles without a value
        mean = np.nanmean(values, axis=(1, 2))
        middle = np.nanmedian(values, axis=(1, 2))[:, None, None]
        level, form = _cut_off(values, _spread(values)), _cut_off(values - middle, spread := _spread(values - middle))
        form -= np.nanmean(form, axis=(1, 2))[:, None, None]
    sums = np.nansum(level, axis=(1, 2)), np.nansum(level * level, axis=(1, 2))
    ratio, n = _ratio(*sums), np.maximum(count, 2)
    # Student's t follows from sum over root of the sum of squares, and has a normal equivalent.
    t = np.minimum(np.abs(ratio) * np.sqrt((n - 1) / np.maximum(n - ratio**2, _EXACT * n)), _MOST_T)
    height, shape = -np.sign(ratio) * ndtri(stdtr(n - 1, -t)), _ratio(*_products(form))
    sd = spread[:, 0, 0] / np.sqrt(n)
    least = np.full(len(n), np.inf)
    if judge:
        counts, heaps = _least_heaps(difference.shape[1])
        least = heaps[np.searchsorted(counts, n, side="right") - 1] * spread[:, 0, 0]
    found = mean, _largest(values), height, shape, sd, least
    return GroundChange(*(np.where(enough, each, np.nan) for each in found))


def _largest(values: Floats) -> Floats:
    """Return the value farthest from 0 that two pixels that share a side both reach, (n,)."""
    out = np.zeros(len(values))
    for first, second in ((values[:, 1:], values[:, :-1]), (values[:, :, 1:], values[:, :, :-1])):
        up = np.fmax.reduce(np.minimum(first, second), axis=(1, 2), initial=0.0)
        down = np.fmin.reduce(np.maximum(first, second), axis=(1, 2), initial=0.0)
        for each in (up, down):
            out = np.where(np.abs(each) > np.abs(out), each, out)
    return out


def _spread(values: Floats) -> Floats:
    """Return the standard deviation of the differences of each tile, from the median of their sizes, (n, 1, 1)."""
    return np.maximum(_NORMAL_MAD * np.nanmedian(np.abs(values), axis=(1, 2))[:, None, None], _FLOOR_M)


def _cut_off(values: Floats, spread: Floats) -> Floats:
    """Divide by the standard deviation, and cut off what is larger than ``_CUT``."""
    return np.clip(values / spread, -_CUT, _CUT)


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


def _ratio(total: Floats, square: Floats) -> Floats:
    """Return sum over root of the sum of squares; 0 where nothing differs."""
    return np.asarray(total / np.sqrt(np.where(square > 0.0, square, 1.0)))


_AS_BEFORE, _ROUGHER, _SMOOTHER, _UNKNOWN, _OPEN = range(1, 6)
_FEW = 100
"""Fewer unchanged tiles tell no spread of the ride cost (chosen: 7 % error): that of the intervals is taken."""
SAME_RIDE = 1.5
"""Most ratio of two ride costs that are alike, chosen."""


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


def decide(ground: GroundChange, ride: tuple[Floats, Floats], fdr: float) -> Decision:
    """Find the tiles that have changed.

    ``ground``, ``ride``: of all tiles, (rows, cols), from `ground_changes` and `ride_change`; ``fdr``: share of false
    discoveries, for the ground and again for the ride.
    """
    widened = {"height": widening(ground.z_height), "shape": widening(ground.z_shape)}
    height = ground.z_height / widened["height"]
    # What all tiles have in common is no change of any: a shift of one survey makes every shape differ a little.
    known = ground.z_shape[np.isfinite(ground.z_shape)]
    common = max(0.0, float(np.median(known))) if len(known) else 0.0
    shape = (ground.z_shape - common) / widened["shape"]
    of_ground = np.minimum(1.0, 2.0 * np.fmin(two_sided(height), stdtr(_FREEDOM, -shape)))
    moved = hold_false_discoveries(of_ground, fdr)
    log_ratio, sd = ride
    z = log_ratio / sd
    still = np.abs(z[np.isfinite(z) & np.isfinite(of_ground) & ~moved])
    usual = _NORMAL_MAD * float(np.median(still)) if len(still) else 1.0
    widened["c_r"] = max(usual, 1.0 if len(still) < _FEW else _LEAST_OWN)
    z = z / widened["c_r"]
    rides = hold_false_discoveries(np.where(moved, two_sided(z), np.nan), fdr)
    bounded = np.abs(log_ratio) + NORMAL_80 * widened["c_r"] * sd <= np.log(SAME_RIDE)
    code = np.where(moved, np.where(bounded, _AS_BEFORE, _OPEN), 0).astype(np.float64)
    code[moved & np.isnan(z)] = _UNKNOWN
    code[rides] = np.where(z[rides] > 0.0, _ROUGHER, _SMOOTHER)
    code[np.isnan(of_ground)] = np.nan
    return Decision(height, shape, z, code, widened)
