"""Steps between neighbouring tiles and inside them, and what they do to a vehicle.

*Finding.* A tile is rated alone, its relief mirrored at the edges, which turns a wall on an edge into level ground.
Here the ground on both sides of a pixel is continued to that pixel, whichever tiles they belong to; the step is the
difference.

1. *Runs.* The median of nine pixels side by side (1.8 m) along the possible wall. A wall that is not parallel to the
   pixels stays sharp; stones and bushes of less than a metre, which show in the relief of their tile, are left out.
2. *Sides.* Each side is as many pixels as a wheel is wide in diameter (2 to 4), continued with the slope on which the
   nearest four agree (the smallest difference, none if they differ in sign). The step is from the highest of the lower
   side to the lowest of the higher one; unless that is most of the usual difference, there is a bank or a narrow ditch.
   The pixel itself is left out: a wall that crosses it gives it the mean of both levels. Where the nearest pixels are
   unknown, the step is less in the same proportion as the sides are farther apart: it may be a slope.
3. *Slopes.* Where the slopes of both sides differ, the step is the least that fits anywhere in the pixel: the foot of a
   bank of 27 degrees reads as 4 cm at most.
4. *Rough ground and noise.* Steps count where they stand out from what is everywhere in the tile: none up to a limit,
   in full from 1.4 times that, smoothly in between. The limit is 12 times the 20 % quantile of all steps in the tile,
   or, if that is more, 2.5 times the noise of a pixel (from the median difference between neighbouring pixels).
5. *Points.* The single pixels of both sides, in 1.8 m along the wall and 1.85 wheels across it, must bear the step out
   at one of five angles: with few pixels all of them, with many all but a fifth. So a survey with few points finds no
   step in rough ground where one with many finds none.
6. *Ridges.* A wall or ridge is a step however narrow it is. Where a pixel stands out from the runs 3 and 4 pixels away
   on both sides, the pixels on a line through it (1.8 m, the best of nine angles) are compared with those from 0.7 to
   1.85 wheels beside it: the step is from the median of the higher side to that of the line, borne out as in 2 by
   three quarters of the line and, as in 5, by the points on both sides.

*Closing.* A step that the vehicle cannot cross closes the pixels on its line, and not its tile:

7. Of the steps above, where many points fell, all that any part of them bears out, at their full height: to close is
   the safe side.
8. Jumps. With few or noisy points, runs of nine pixels tell little. There, for lines at eight angles through a pixel, a
   plane is fitted through all pixels on each side, 1.8 m along the line and 1 m across it. The ground jumps where both
   planes and both mean levels differ by the height, surely, and the points lie close to the planes.
9. Where a step is known, or the tile fails, every pixel of it that lies so far below one beside it is closed too: runs
   do not tell the last metre of a ditch.

A step depends only on the pixels around it, so two blocks find the same bits for the border that they share.

*Effect.* Tiles are rated as those with the same step in their middle, borders as usable or not. The calibration holds
what steps do (its ``steps``, see ``bumpymap.lab.simulate.refit``): its ride model's rating of tiles with a step well
inside, and drives over single walls, up and down, at several angles. From these come curves over the height of a step
that never fall, with straight lines between the known heights:

- C_r and p_fail of a tile: the mean, and the 80 % quantile, over steps at several places and directions in the tile;
  C_r is proportional to the height below the lowest. Above the highest known step, the curves stay.
- p_fail of a crossing, up and down: the mean over the angles.

*Beside steps.* A tile with a ditch in it fails as a whole, and so would the bridge over it. So the pixels of steps that
the vehicle cannot cross are taken out, with those beside them, which may hold a part of its face. What is left falls
into areas that hang together; each has a slope of its own, and what is left after the planes of all of them are removed
is the relief that the ride model rolls over. Noise is taken off as in the rating of whole tiles; it is estimated from
pairs of points, because the spread of each pixel is not kept.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    FAIL_SHARE,
    NO_CLASS,
    NORMAL_80,
    BadInputError,
    Floats,
    Mask,
    loops,
    obstacle_reach,
    tiles_of,
    within,
)
from bumpymap.rating.calibration import Calibration, remembered
from bumpymap.rating.ride.correction import class_chance
from bumpymap.rating.ride.operator import roll_over
from bumpymap.rating.ride.rate import RideModel, interval, take_noise_off
from bumpymap.rating.ride.speed import plain_speed_factor, speed_log_sd
from bumpymap.rating.ride.thin import THIN_COLUMNS
from bumpymap.rating.vehicle_profile import less_floor, with_floor

STEP_COLUMNS = ("class_id", "c_r", "c_r_low", "c_r_high", "p_fail", "confidence")
"""The columns that `apply_steps` changes."""
_LEAST_LOG_SD = 0.1
"""Least standard deviation of ln C_r between steps of one height. Chosen: the places and directions are few."""
_TINY = 1e-9
"""C_r that stands for 0 in a logarithm, rad/m."""


@dataclass(frozen=True, slots=True)
class StepEffect:
    """Curves over the height of a step; all arrays are (k,), from a height of 0 on."""

    height: Floats
    """m, increasing."""
    c_r: Floats
    """C_r of a tile with such a step, rad/m."""
    c_r_log_sd: Floats
    """Standard deviation of ln C_r between places and directions of the step."""
    p_fail: Floats
    """p_fail of a tile with such a step."""
    p_up: Floats
    """p_fail of a crossing upwards."""
    p_down: Floats
    """p_fail of a crossing downwards."""

    @classmethod
    def of(cls, calibration: Calibration) -> "StepEffect":
        """Read the ``steps`` of a calibration; raise BadInputError if they are damaged."""
        try:
            return _recorded(calibration.steps)
        except (LookupError, TypeError, ValueError) as error:
            raise BadInputError(
                f"the record of steps in the calibration {calibration.id} is damaged: {error!r}. Make it again "
                "with: bumpymap calibrate --vehicle FILE --out CALIBRATION.json"
            ) from error

    def read(self, curve: Floats, step: NDArray[np.floating]) -> Floats:
        """Read a curve at steps [m] of any shape; NaN counts as no step; above the highest step the curve stays."""
        return np.asarray(np.interp(np.fmax(step.astype(np.float64), 0.0), self.height, curve))


def apply_steps(
    columns: Mapping[str, NDArray[Any]], step: NDArray[np.floating], calibration: Calibration
) -> dict[str, NDArray[Any]]:
    """Rate tiles with steps as tiles with the same step in their middle; no tile gets better.

    ``c_r``, its interval and ``p_fail`` are the larger ones of the tile's own and of those of the step. The class
    follows from them as in the rating: that of the C_r, and the roughest if p_fail is at least one half. Tiles without
    class, and those with a step of 0 or NaN, keep their bits.

    ``columns``: ``STEP_COLUMNS`` and ``coverage``, arrays of one shape, as in `CostMap`; ``step``: of the same shape,
    `TileSteps.unseen`, m. Returns ``STEP_COLUMNS``, in the types they came in; raises BadInputError if the
    calibration's record of steps is damaged.
    """
    effect = _effect(calibration)
    own = {name: np.asarray(columns[name]) for name in STEP_COLUMNS}
    known = own["class_id"] != NO_CLASS
    driven, fails, sd = (effect.read(curve, step) for curve in (effect.c_r, effect.p_fail, effect.c_r_log_sd))
    # Without a step there is nothing that a floor could be added to.
    c_r, low, high = (
        np.where(driven > 0.0, with_floor(driven * np.exp(tail * sd), calibration.map_floor), 0.0)
        for tail in (0.0, -NORMAL_80, NORMAL_80)
    )
    raised = known & (c_r > own["c_r"])
    felt = {
        "c_r": np.maximum(own["c_r"], c_r),
        "c_r_low": np.maximum(own["c_r_low"], low),
        "c_r_high": np.maximum(own["c_r_high"], high),
        "p_fail": np.maximum(own["p_fail"], fails),
    }
    lost = fails >= FAIL_SHARE
    class_id = np.maximum(own["class_id"], np.searchsorted(np.array(calibration.class_limits), driven, side="right"))
    class_id = np.where(lost, len(calibration.class_limits), class_id)
    changed = known & (raised | (lost & ~(own["p_fail"] >= FAIL_SHARE)))
    log_c_r = np.log(np.maximum(np.nan_to_num(less_floor(felt["c_r"], calibration.map_floor)), 1e-9))
    rank = np.minimum(class_id, len(calibration.class_limits)).astype(np.int64)
    sure = np.where(lost, fails, class_chance(rank, log_c_r, (sd, sd), calibration.class_limits))
    felt["confidence"] = np.where(changed, sure * np.sqrt(columns["coverage"]), own["confidence"])
    felt["class_id"] = class_id
    return {name: np.where(known, felt[name], own[name]).astype(own[name].dtype) for name in STEP_COLUMNS}


def crossing_fails(step: NDArray[np.floating], calibration: Calibration) -> NDArray[np.float32]:
    """Return p_fail of a crossing of steps [m] in the worse of both directions, of their shape; NaN where unknown."""
    effect = _effect(calibration)
    worse = np.maximum(effect.read(effect.p_up, step), effect.read(effect.p_down, step))
    return np.where(np.isnan(step), np.nan, worse).astype(np.float32)


@remembered
def closing_height(calibration: Calibration) -> float:
    """Return the least height of a step [m] that half of the crossings fail, up or down; infinite if there is none."""
    effect = _effect(calibration)
    fails = np.maximum(effect.p_up, effect.p_down)
    above = np.flatnonzero(fails >= FAIL_SHARE)
    if not len(above) or above[0] == 0:
        return 0.0 if len(above) else math.inf
    ends = np.s_[above[0] - 1 : above[0] + 1]
    return float(np.interp(FAIL_SHARE, fails[ends], effect.height[ends]))


def edge_usable(border: NDArray[np.floating], calibration: Calibration) -> NDArray[np.bool_]:
    """Return which borders a vehicle can cross both ways: p_fail of a crossing is below one half.

    ``border``: steps of any shape, m, such as `TileSteps.border`. An unknown one (NaN) is not usable; ``numpy.isnan``
    tells it from a wall.
    """
    return np.asarray(crossing_fails(border, calibration) < FAIL_SHARE)


@remembered
def _effect(calibration: Calibration) -> StepEffect:
    """Return the effect of steps at the speed of the map."""
    effect = StepEffect.of(calibration)
    log_c_r = np.log(np.maximum(effect.c_r, _TINY))
    return replace(effect, c_r=effect.c_r * np.exp(plain_speed_factor(calibration, log_c_r)))


def _recorded(record: Mapping[str, Any]) -> StepEffect:
    tile, crossing = record["tile"], record["crossing"]
    height, c_r, sd, fails = (np.array(tile[name], np.float64) for name in ("height", "c_r", "c_r_log_sd", "p_fail"))
    walls = np.array(crossing["height"], np.float64)
    ways = [np.array(crossing[name], np.float64).reshape(len(walls), -1) for name in ("fail_up", "fail_down")]
    for rising in (height, walls):
        if len(rising) < 1 or rising[0] <= 0 or (np.diff(rising) <= 0).any():
            raise ValueError("heights must be positive and increasing")
    if not all(np.isfinite(values).all() for values in (c_r, sd, fails, *ways)):
        raise ValueError("a number is missing")
    up, down = (np.interp(height, walls, np.maximum.accumulate(way.mean(axis=1))) for way in ways)
    curves = [np.maximum.accumulate(curve) for curve in (c_r, fails)]
    c_r, fails, up, down = (np.concatenate(([0.0], curve)) for curve in (*curves, up, down))
    sd = np.maximum(np.concatenate((sd[:1], sd)), _LEAST_LOG_SD)
    return StepEffect(np.concatenate(([0.0], height)), c_r, sd, fails, up, down)


_RUN = 4
"""Pixels before and after the middle one of a run."""
_REACH = 4
"""Pixels on each side of a step that are looked at."""
_UNKNOWN_NOISE = 0.15
"""Steps below this do not count where the noise of both sides is unknown, m."""
_QUANTILE, _QUANTILE_LIMIT = 0.2, 12.0
"""Steps count above 12 times the 20 % quantile of all steps in the tile (4 above). Chosen, as the next."""
_PIXEL_LIMIT = 2.5
"""Limit of noise over the noise of a pixel."""
_MEDIAN_DIFFERENCE = 0.9539
"""Median size of the difference of two numbers from a standard normal distribution."""
_LEVEL_WIDTH = 1.85
"""Width of the levels on both sides of a step, in diameters of a wheel. A fifth of their points may be astray, so a
ditch of less than 1.4 diameters is none; in drives over ditches, half get stuck at 1.4."""
_THINNEST, _MOST_COVERAGE = 0.04, 0.8
"""Shares of known pixels: with fewer nothing tells a jump; with more, runs of pixels do as well as all points."""
_MEDIAN_ERROR = 1.858
"""Standard error of the median of n numbers over their median distance from it and the root of n (normal numbers)."""
_APART = 3
"""Pixels between those whose heights tell the slope of a tile that is searched for jumps."""
_JUMP_WIDTH = 5.0
"""Width of the sides of a jump, px."""
_TOUCHING = 1.5
"""Pixels nearer than this lie beside one another, by their sides or corners, px."""
_JUMP = 2.4
"""Height between two pixels that is not noise, over the limit of noise: six standard deviations of a pixel."""
_LEAST_STEPS = 12
"""With fewer known steps in a tile, its noise is unknown."""


class StepMosaic(NamedTuple):
    """Heights of tiles side by side."""

    heights: Floats
    """(rows + 8, cols) m; NaN in unknown pixels, and in the four rows before the first tile and after the last one."""
    pixels: int
    """Along a side of a tile."""
    level: float
    """Width of the levels on both sides of a step, px."""
    east: Floats
    """(tiles, cols) gradient of the tile from one pixel to its eastern neighbour, m."""
    south: Floats
    """The same to its southern neighbour."""


@dataclass(frozen=True, slots=True)
class TileSteps:
    """Steps of n x m tiles, north row first, in m, never negative; a step has the same height up and down."""

    border: NDArray[np.float32]
    """(n, m, 4) highest step within a pixel of the border to the northern, eastern, southern and western tile; NaN if
    no ground is known on both sides of it. A border has the same value seen from both of its tiles."""
    inner: NDArray[np.float32]
    """(n, m) highest step in the pixels of the tile; NaN if nothing is known."""
    rim: NDArray[np.float32]
    """(n, m) highest step in the two pixels along a border and across it: what the mirrored relief of the tile does not
    show. The rating of a tile sees steps farther inside in full."""
    closed: NDArray[np.bool_]
    """((n + 2) * pixels, (m + 2) * pixels) pixels with a step that the vehicle cannot cross, on its line, in the inner
    tiles and in the pixels of the ring that touch them; False elsewhere."""
    low: NDArray[np.bool_]
    """Of the same shape: pixels so far below one beside them, and well beyond the noise of their tile. Runs of pixels
    do not tell the last metre of a ditch, or a hole; these do where it is known that the ground breaks off or fails."""
    limit: NDArray[np.float32]
    """(n, m) up to that height steps do not stand out from noise and roughness of the tile; of `bumpymap.core`, see
    `smallest_step`."""

    def inner_tiles(self, pixels: int) -> "TileSteps":
        """Return the steps without the outermost tiles; ``closed`` and ``low`` (n, m, pixels, pixels) of the others."""
        inner = np.s_[1:-1, 1:-1]
        closed, low = (tiles_of(marks, pixels)[2:-2, 2:-2] for marks in (self.closed, self.low))
        return TileSteps(self.border[inner], self.inner[inner], self.rim[inner], closed, low, self.limit[inner])

    @property
    def edge_step(self) -> NDArray[np.float32]:
        """(n, m) the highest of the four borders; NaN if all are unknown."""
        return np.asarray(np.fmax.reduce(self.border, axis=-1))

    @property
    def unseen(self) -> NDArray[np.float32]:
        """(n, m) the highest step at the borders or next to them, for `apply_steps`; NaN if nothing is known."""
        return np.fmax(self.rim, self.edge_step)


def find_steps(
    heights: NDArray[np.floating],
    pixels: int,
    wheel: float = 3.0,
    closing: float = np.inf,
    standing: NDArray[np.bool_] | None = None,
    searched: NDArray[np.bool_] | None = None,
) -> TileSteps:
    """Find the steps of n x m tiles, such as the 16 x 16 of a block.

    ``heights`` ((n + 2) * pixels, (m + 2) * pixels): heightmaps of the tiles and of a ring of one tile around them, m,
    north row first; NaN where no point fell and in tiles that do not exist. ``pixels``: along the side of a tile, at
    least 10. ``wheel``: diameter of a wheel, px: it rolls over ditches narrower than 1.4 times that, which are no
    steps. ``closing``: height of a step that the vehicle cannot cross, m, see `closing_height`. ``standing``, of the
    shape of ``heights``: pixels of standing objects that are obstacles; they and those beside them, which may
    hold its sides, count as unknown. ``searched`` (n + 2, m + 2): tiles in which all points are searched for jumps, if
    many of their pixels are unknown; by default all.

    Raises ValueError if the sides of ``heights`` are not multiples of ``pixels``, or there are fewer than 3 x 3 tiles
    or 10 pixels.
    """
    sides = heights.shape
    if pixels < 2 * _REACH + 2 or len(sides) != 2 or min(sides) < 3 * pixels or any(n % pixels for n in sides):
        raise ValueError(f"heights of shape {sides} are not those of tiles with {pixels} pixels and a ring of them")
    side = int(np.clip(round(wheel), 2, _REACH))
    # Nothing beyond the ring of tiles may count, or two blocks would differ on the border that they share; and whether
    # the last pixel of the ring lies beside an obstacle is not known.
    level = min(_LEVEL_WIDTH * wheel, (pixels - _RUN - 2) / math.sqrt(2.0))
    whole, is_thin = heights, tiles_of(np.isfinite(heights), pixels).sum(axis=(2, 3)) < _MOST_COVERAGE * pixels**2
    if standing is not None and standing.any():
        heights = np.where(within(standing, _TOUCHING), np.nan, heights)
    z, turned = (
        np.pad(np.ascontiguousarray(part, np.float64), ((_RUN, _RUN), (0, 0)), constant_values=np.nan)
        for part in (heights, heights.T)
    )
    (east, noise_east), (south, noise_south) = _gradient(z, pixels), _gradient(turned, pixels)
    upright, lying = (
        StepMosaic(part, pixels, level, np.repeat(right, pixels, axis=1), np.repeat(down, pixels, axis=1))
        for part, right, down in ((z, east, south.T), (turned, south, east.T))
    )
    across, along = _raw(upright, side), _raw(lying, side)  # walls that run north to south come first
    noise = _PIXEL_LIMIT / _MEDIAN_DIFFERENCE * 0.5 * (noise_east + noise_south.T)
    usual = np.empty(noise.shape)  # a low quantile of the steps whose support lies in the tile; NaN with too few
    loops.find_quantiles(across[2], along[2], _QUANTILE, _LEAST_STEPS, usual)
    limit = np.fmax(_QUANTILE_LIMIT * usual, noise)
    west_east, marks = _peaks(upright, across, limit, closing)
    north_south, marks_too = _peaks(lying, along, np.ascontiguousarray(limit.T), closing)
    rim, inner = np.moveaxis(np.fmax(west_east, north_south.swapaxes(0, 1))[1:-1, 1:-1, 2:], -1, 0)
    west, east = _borders(west_east)
    north, south = (side.T for side in _borders(north_south))
    border = np.stack([north, east, south, west], axis=-1)
    closed, low, jumps = np.empty(sides, np.bool_), np.empty(sides, np.bool_), np.zeros(sides, np.bool_)
    wanted = is_thin & (tiles_of(np.isfinite(whole), pixels).sum(axis=(2, 3)) > _THINNEST * pixels**2)
    wanted = wanted if searched is None else wanted & searched
    if math.isfinite(closing) and wanted.any():
        asked = np.ascontiguousarray(wanted.T)
        slopes = _sure_gradient(z, pixels, wanted), np.ascontiguousarray(_sure_gradient(turned, pixels, asked).T)
        dense = np.ascontiguousarray(whole, np.float64)
        loops.find_jumps(dense, pixels, *slopes, wanted, closing, min(level, _JUMP_WIDTH), jumps)
    loops.find_low(np.ascontiguousarray(heights, np.float32), pixels, np.fmax(closing, _JUMP * noise), low)
    loops.close_steps(marks, marks_too, pixels, is_thin, jumps, low, closed)
    own = np.where(np.isnan(limit), _UNKNOWN_NOISE, limit)[1:-1, 1:-1]
    border, inner, rim, own = (part.astype(np.float32) for part in (border, inner, rim, own))
    return TileSteps(border, inner, rim, closed, low, own)


def _sure_gradient(z: Floats, pixels: int, asked: NDArray[np.bool_]) -> Floats:
    """Return how much of the rise from a pixel to the next one, m, is beyond two standard errors, in ``asked`` tiles.

    Pixels that are ``_APART`` tell it: of neighbours, few are known in a thin survey, and their noise counts in full.
    """
    rise, spread = _gradient(z, pixels, _APART, asked)
    known = np.isfinite(z[_RUN:-_RUN])
    known[:, :-_APART] &= known[:, _APART:]
    columns = np.arange(known.shape[1]) % pixels
    known[:, columns >= pixels - _APART] = False
    error = _MEDIAN_ERROR * spread / np.sqrt(np.maximum(tiles_of(known, pixels).sum(axis=(2, 3)), 1))
    return np.asarray(np.sign(rise) * np.nan_to_num(np.maximum(np.abs(rise) - 2.0 * error, 0.0))) / _APART


def _gradient(z: Floats, pixels: int, apart: int = 1, asked: NDArray[np.bool_] | None = None) -> tuple[Floats, Floats]:
    """Return the median difference from a pixel to one so far east of it in each tile, m; 0 where there is none.

    The second array is the median distance of the differences from it, m; NaN with too few, and in tiles that are not
    ``asked`` for, if these are given.
    """
    heights = z[_RUN:-_RUN]
    middle, spread = (np.empty((len(heights) // pixels, heights.shape[1] // pixels)) for _ in range(2))
    asked = np.ones(middle.shape, np.bool_) if asked is None else asked
    loops.find_gradients(heights, pixels, apart, _LEAST_STEPS, asked, middle, spread)
    return middle, spread


def _raw(mosaic: StepMosaic, side: int) -> tuple[Floats, Floats, Floats]:
    """Return least steps from west to east and crests at every pixel, and the steps in the middle of inner pixels."""
    tiles, cols = mosaic.east.shape
    pixels = mosaic.pixels
    inside = (pixels - 2 * _RUN) * (pixels - 2 * _REACH)
    least, crest = (np.empty((tiles * pixels, cols)) for _ in range(2))
    found = np.empty((tiles, cols // pixels, inside))
    loops.find_raw_steps(mosaic, side, least, crest, found)
    return least, crest, found


def _peaks(
    mosaic: StepMosaic, raw: tuple[Floats, Floats, Floats], limit: Floats, closing: float
) -> tuple[Floats, NDArray[np.uint8]]:
    """Return the highest steps that stand out at the borders of each tile, near them and in it, (tiles, tiles, 4).

    Also return the pixels with a step that closes, surely (2) or if in doubt (1).
    """
    least, crest, _ = raw
    found, closed = np.full((*limit.shape, 4), np.nan), np.zeros(least.shape, np.uint8)
    loops.find_peaks(mosaic, least, crest, limit, closing, found, closed)
    found[found < 0.0] = np.nan
    return found + 0.0, closed  # never -0.0: the sign of nothing would depend on the machine


def _borders(highest: Floats) -> tuple[Floats, Floats]:
    """Return the highest step at the western and at the eastern border of the inner tiles."""
    west, east = highest[1:-1, :, 0], highest[1:-1, :, 1]
    both = np.fmax(east[:, :-1], west[:, 1:])
    return both[:, :-1], both[:, 1:]


_FACE_PX = 2.3
"""From the line of a step, px: so near, a pixel may hold a part of its face."""
_LEAST_PIXELS = 3
"""Known pixels that span the plane of an area."""
_RIDGE = 1.0
"""Pixels^2 added to the spread of the known pixels: a few close together say little about the slope."""


def rate_beside_steps(
    heights: NDArray[np.floating], line: Mask, standing: Mask,
    whole: tuple[NDArray[np.floating], NDArray[np.floating]], thin: NDArray[np.floating], calibration: Calibration,
) -> tuple[Mask, NDArray[np.float32], NDArray[np.float32]]:  # fmt: skip
    """Rate what steps leave of n tiles, in the ride of the calibration's vehicle.

    ``heights`` (n, pixels, pixels): mean height of the ground in each pixel, m; NaN where it is not known. ``line``,
    ``standing`` (n, pixels, pixels): pixels of the tiles' own steps that the vehicle cannot cross; of obstacles and
    what was not seen. ``whole``: C_r and p_fail of whole tiles, (n,) each: what is left of them is no worse. ``thin``
    (n, 44): of `thin_columns`. Returns (n, pixels, pixels) ground beside the steps that the vehicle cannot drive on,
    too steep or where too many fail; C_r [rad/m] and p_fail of the rest, (n,) each, NaN where nothing is left. Raises
    BadInputError if the ride model of the calibration is damaged.
    """
    _, from_line = _nearest(line)
    left = (from_line > _FACE_PX) & ~standing
    number = np.empty(left.shape, np.uint8)
    loops.number_areas(left[None].view(np.uint8), False, number[None])  # by their sides
    most, tiles = int(number.max()), np.arange(len(line))[:, None, None]
    areas, area = most * len(line), np.where(number > 0, number + most * tiles, 0)
    pixel, room = calibration.tile_size / calibration.pixels, np.zeros(areas + 1)
    # Where the middle of the vehicle cannot be for the step alone, nobody asks for the ground.
    np.maximum.at(room, area, from_line)
    area[room[area] * pixel <= obstacle_reach(calibration.body.width_m)] = 0
    known = (area > 0) & np.isfinite(heights)
    rest, rise = _off_planes(heights, np.where(known, area, 0), areas)
    slope_deg = np.degrees(np.arctan(rise / pixel))
    steep = slope_deg > float(calibration.vehicle["slope_limit_deg"])
    is_open = (area > 0) & ~steep[area]
    known &= is_open
    relief = np.full(heights.shape, np.nan, np.float32)
    if (usable := known.any(axis=(1, 2))).any():
        nearest, _ = _nearest(known[usable])
        flat = (len(nearest), -1)
        relief[usable] = np.take_along_axis(rest[usable].reshape(flat), nearest.reshape(flat), 1).reshape(nearest.shape)
    slope = np.where(is_open, slope_deg[area], 0.0).max(axis=(1, 2), initial=0.0)
    found = _ride(relief, known.sum(axis=(1, 2)), slope, thin, calibration)
    c_r, p_fail = (np.fmin(ours, of_whole) for ours, of_whole in zip(found, whole, strict=True))
    is_open &= (p_fail < FAIL_SHARE)[:, None, None]
    some = is_open.any(axis=(1, 2))
    c_r, p_fail = (np.where(some, values, np.nan).astype(np.float32) for values in (c_r, p_fail))
    return left & ~is_open, c_r, p_fail


def _nearest(marks: Mask) -> tuple[NDArray[np.int32], Floats]:
    """Return place in its tile and distance [px] of the nearest marked pixel; -1 and infinite in tiles without any."""
    place, square = (np.empty(marks.shape, np.int32) for _ in range(2))
    loops.find_nearest(marks, place, square)
    return place, np.where(place < 0, np.inf, np.sqrt(np.maximum(square, 0)))


def _off_planes(heights: NDArray[np.floating], area: NDArray[np.integer], areas: int) -> tuple[Floats, Floats]:
    """Return heights less the plane of their area, and the slope of each area as rise per pixel, (areas + 1,).

    ``area`` numbers the known pixels of areas from 1; 0: none.
    """
    index = area.ravel()
    places = np.indices(heights.shape, np.float64).reshape(3, -1)[1:]
    z = np.where(index > 0, heights.ravel(), 0.0)
    number = np.maximum(np.bincount(index, minlength=areas + 1), 1)

    def mean(values: Floats) -> Floats:
        return np.bincount(index, values, areas + 1) / number

    base = mean(z)
    x, y = (place - mean(place)[index] for place in places)
    h = z - base[index]
    xx, xy, yy, xh, yh = (mean(a * b) * number for a, b in ((x, x), (x, y), (y, y), (x, h), (y, h)))
    xx, yy = xx + number * _RIDGE, yy + number * _RIDGE
    det = xx * yy - xy * xy
    spanned = number >= _LEAST_PIXELS
    down = np.where(spanned, (xh * yy - yh * xy) / det, 0.0)
    right = np.where(spanned, (yh * xx - xh * xy) / det, 0.0)
    rest = h - down[index] * x - right[index] * y
    return rest.reshape(heights.shape), np.hypot(down, right)


_model = remembered(RideModel)


def _ride(
    relief: NDArray[np.float32],
    known: NDArray[np.int64],
    slope: Floats,
    thin: NDArray[np.floating],
    calibration: Calibration,
) -> tuple[Floats, Floats]:
    """Return C_r [rad/m] and p_fail of reliefs by the number of ``known`` pixels and slope [degrees]; or NaN."""
    model, pixels = _model(calibration), relief.shape[1]
    points, squares, pairs = (
        thin[:, THIN_COLUMNS.index(name)].astype(np.float64) for name in ("points", "squares", "pairs")
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        of_point = np.nan_to_num(0.5 * squares / pairs, posinf=0.0)
        per_pixel = np.maximum(np.nan_to_num(points / np.maximum(known, 1), nan=1.0), 1.0)
    shape = relief.shape
    # The loop takes the spread of the pixels' own points, two at least, and corrects the bias of their median.
    count = np.maximum(per_pixel, 2.0).astype(np.int32)
    variance = of_point / per_pixel * (count - 1) * (1.0 - 2.0 / (9.0 * (count - 1))) ** 3
    of_tile = np.s_[:, None, None]
    clean, noise = take_noise_off(
        relief,
        np.isfinite(relief[:, 0, 0]),
        np.broadcast_to(count[of_tile], shape),
        np.broadcast_to(variance.astype(np.float32)[of_tile], shape),
    )
    rides = roll_over(clean, model.operator)
    found = model.correction.predict(rides, slope, noise[1] * model.operator.noise_gain, points / pixels**2)
    found = found.at_speed(plain_speed_factor(calibration, found.log_c_r), speed_log_sd(calibration))
    return interval(found, calibration.map_floor)[0], found.p_fail
