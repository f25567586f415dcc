"""The ride of one line: the vehicle rolled along it over the pixels of a map.

The ride cost of a tile is the mean over all headings and places; a vehicle drives one line. The heights of the tiles
that its wheels touch are denoised just so far that their predicted C_r is the one that the map states (`match_noise`).
The wheels roll along the line over these heights, across the borders of tiles, and the change of the chassis' pitch is
turned into C_r by the correction that the drives of the calibration taught (`felt_along`). Where a wheel meets ground
whose height is not known, the metre has the ride cost of its tile.

The axles follow the line, half a wheelbase before and behind each sample, and the wheels stand beside them at right
angles to the vehicle. Where the vehicle is across the line is known to ``sigma``: it is rolled at three places, those
of Gauss-Hermite quadrature.
"""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    CANOPY,
    NORMAL_80,
    OBSTACLE,
    BadInputError,
    Floats,
    Mask,
    UsageError,
    interval_log_sd,
    loops,
    path_of_call,
    tiles_of,
)
from bumpymap.layers import MapReader, common_window, open_map
from bumpymap.rating import (
    Calibration,
    Correction,
    MotionOperator,
    RideOperator,
    Vehicle,
    at_speed,
    chassis_response,
    felt_along,
    heave_filter,
    less_floor,
    map_calibration,
    match_noise,
    motion_factors,
    motion_felt,
    move_over,
    remove_plane,
    roll_over,
    roll_wheels,
    smooth_over,
    wheel_turn,
    with_floor,
)
from bumpymap.route.ground import CostGround, points_along, window_around
from bumpymap.route.measure import MeasuredWay
from bumpymap.route.places import in_window

_SIGMA_M = 0.3
"""Standard deviation of where a vehicle is across its line by default, m (chosen)."""
_ACROSS, _WEIGHTS = (-math.sqrt(3.0), 0.0, math.sqrt(3.0)), (1 / 6, 2 / 3, 1 / 6)
"""Places across the line, standard deviations, and their weights: Gauss-Hermite quadrature of three points."""
_ALIKE_M, _MOST_SIGMA = 0.5, 2.0
"""Distance in which ground is alike, m: if the error is larger, there is a place at each such distance, up to that
multiple of the error (chosen)."""
_STRETCH_M, _WINDOW_TILES = 90.0, 1024
"""Length whose window of the map is read at once, m; with those after it while the window holds no more tiles than
that, and no more than twice those of their own windows (chosen)."""
_PIECE_M = 2000.0
"""Length that is computed at once, m (chosen)."""
_TILE_LOG_SD = 1.2
"""Standard deviation of ln C_r of a metre of a line about that of its tile: 0.4 over 10 m. The width that held 80 % of
simulated drives along such lines was 0.39 on the sample, 0.28 on a real survey."""
_FILL_ROUNDS = 3
"""Half the width of the holes that are filled with the mean of their neighbours, pixels (chosen)."""
_LEAST = 1e-5
"""C_r that counts as none, rad/m (chosen)."""
_BANDS = ("c_r", "c_r_low", "c_r_high", "slope")
_SIDES = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
"""Ahead and to the left: of the wheels front left, front right, rear left, rear right."""


@dataclass(frozen=True, slots=True)
class LineRide:
    """Ride of a vehicle along a line, metre by metre; the last part may be shorter."""

    speed_mps: float
    distance: Floats
    """(n + 1,) from the start to the ends of the parts, m."""
    floor: float
    """C_r of the vehicle on even ground, rad/m, which is in ``c_r`` in power."""
    x: Floats
    """(n,) middle of each part, in the CRS of the survey; so is ``y``."""
    y: Floats
    c_r: Floats
    """(n,) pitch motion, rad/m; NaN where the map is unknown."""
    log_sd: Floats
    """(n,) standard deviation of ln ``c_r``, less the floor, that the rating of the tiles leaves; NaN as ``c_r``."""
    log_sd_across: Floats
    """(n,) the same that the place across the line leaves."""
    a_w: Floats
    """(n,) weighted vertical acceleration (ISO 2631-1), m/s2; NaN where unknown, or the calibration has no speeds."""
    by_line: NDArray[np.bool_]
    """(n,) True if it comes from the pixels; else it is the value of the tiles."""
    seen: Floats
    """(n,) share of the places of wheels, 0..1, whose pixel holds points."""
    across: Floats
    """(k,) places across the line at which the vehicle may be, m to the left."""
    weights: Floats
    """(k,) their probabilities; the sum is 1."""
    c_r_across: Floats
    """(k, n) C_r at each of them, rad/m; NaN where a wheel meets ground that is not known there alone."""

    @property
    def pitch_rate(self) -> Floats:
        """(n,) mean size of the pitch rate, rad/s."""
        return self.c_r * self.speed_mps

    def over(self, first: float, last: float) -> tuple[float, float, float]:
        """Return C_r of what is known between two distances [m], and both ends of its 80 % interval, rad/m.

        NaN if nothing is known there.
        """
        starts, ends = self.distance[:-1], self.distance[1:]
        at = np.arange(np.searchsorted(ends, first, "right"), np.searchsorted(starts, last))
        at = at[np.isfinite(self.c_r[at])]
        if not len(at):
            return (np.nan, np.nan, np.nan)
        share = np.minimum(ends[at], last) - np.maximum(starts[at], first)
        share /= share.sum()
        bare = less_floor(self.c_r[at], self.floor)
        # The model of the vehicle errs alike in all tiles, the place across differs from metre to metre.
        weight = share * bare / max(float((share * bare).sum()), 1e-12)
        of_place = np.sqrt(((weight * self.log_sd_across[at]) ** 2).sum())
        wide = np.exp(NORMAL_80 * np.hypot((weight * self.log_sd[at]).sum(), of_place))
        mean, low, high = (float((share * with_floor(bare * by, self.floor)).sum()) for by in (1.0, 1.0 / wide, wide))
        return mean, low, high


class LineVehicle(NamedTuple):
    """A vehicle and its calibration, ready to roll."""

    calibration: Calibration
    correction: Correction
    operator: RideOperator
    moving: MotionOperator | None
    """At the profile's speed, at the one asked for, and at the map's; None if motion at these is not needed."""
    speed: float
    """m/s."""
    way: float
    """Distance between samples, m."""
    taps: Floats
    """How the chassis follows its rockers."""
    reach: int
    """Samples to either side that what is felt depends on."""
    drive_log_sd: float
    """Of the map's `CostRule`."""

    @classmethod
    def of(
        cls, site: MapReader, calibration: Calibration, speed: float | None = None, *, motion: bool = True
    ) -> "LineVehicle":
        """Make what rolling takes; without ``motion`` the vertical acceleration is not needed.

        Raises UsageError: the tiles were not rated by their ride, or the calibration cannot tell it at this speed.
        """
        grid, own = site.grid, float(calibration.vehicle["speed_mps"])
        rated = site.manifest["settings"]
        if (rated.get("rating", "ride"), rated.get("compat", "none")) != ("ride", "none"):
            raise UsageError("the tiles of this map were not rated by their ride; map the survey with `rating='ride'`")
        calibration.require_grid(grid.tile_size, grid.pixels)
        wanted = calibration.map_speed if speed is None else speed
        if wanted != calibration.map_speed:
            at_speed(calibration, wanted)  # refuses what it cannot tell
        needed = motion or not wanted == own == calibration.map_speed
        every = tuple(dict.fromkeys((own, wanted, calibration.map_speed))) if needed else ()
        operator, moving = _operators(calibration.profile, every, grid.tile_size, grid.pixels)
        way = grid.pixel_size / operator.fine / 2
        taps = chassis_response(calibration.profile, way)
        stretch = math.ceil(grid.tile_size / 2 / way)
        reach = len(taps) + max(stretch, len(heave_filter(wanted, way)[0]) // 2 if moving is not None else 0)
        correction, drive_log_sd = Correction.from_record(calibration.ride), site.rule.drive_log_sd
        return cls(calibration, correction, operator, moving, wanted, way, taps, reach, drive_log_sd)


@lru_cache(maxsize=4)
def _operators(
    vehicle: Vehicle, speeds: tuple[float, ...], tile_size: float, pixels: int
) -> tuple[RideOperator, MotionOperator | None]:
    """Make the operators of a vehicle: it takes as long as 1 km of a line; lines are often short."""
    moving = MotionOperator.of(vehicle, tile_size, pixels, speeds) if speeds else None
    return RideOperator.of(vehicle, tile_size, pixels), moving


def ride_along(
    layers: str | os.PathLike[str],
    line: Sequence[Sequence[float]] | NDArray[np.floating],
    *,
    speed: float | None = None,
    sigma: float = _SIGMA_M,
    calibration: str | os.PathLike[str] | None = None,
) -> LineRide:
    """Roll the vehicle of a map along a line.

    Parameters
    ----------
    layers : path or Layers
        What `map_survey` or ``bumpymap map`` wrote.
    line : array (m, 2)
        Corners in the CRS of the survey, x and y.
    speed : float, optional
        m/s; that of the map if not given.
    sigma : float
        Standard deviation of where the vehicle is across the line, m.
    calibration : path, optional
        The file that the map was made with; needed if it is not an included one.

    Raises
    ------
    BadInputError
        The layers cannot be read, or the calibration is not that of the map.
    UsageError
        The line has fewer than two points, a length of 0, numbers that are not finite, or lies outside the map; the
        calibration cannot tell the ride at this speed; or the map was rated by texture.
    """
    site = open_map(path_of_call("layers", layers))
    try:
        corners, across = np.asarray(line, np.float64), float(sigma)
        wanted = None if speed is None else float(speed)
    except (TypeError, ValueError) as error:
        raise UsageError(f"line, speed and sigma are numbers: {error}") from error
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 2 or not np.isfinite(corners).all():
        raise UsageError("line: give two points or more, each with x and y in the CRS of the survey")
    if not 0.0 <= across <= 5.0:
        raise UsageError(f"sigma is {across}; give metres from 0 to 5")
    on_grid = np.column_stack(site.to_grid(corners[:, 0], corners[:, 1]))
    if common_window(site.window, window_around(site, on_grid, 0)) is None:
        raise UsageError("line: it lies outside the map. Give x and y in the CRS of the survey")
    file = None if calibration is None else Path(path_of_call("calibration", calibration))
    vehicle = LineVehicle.of(site, map_calibration(site.manifest, site.grid.tile_size, file), wanted)
    with site.kept_open():
        return ride_line(site, on_grid, vehicle, across)


def line_vehicle(site: MapReader, calibration: Path | None, *, motion: bool = True) -> tuple[LineVehicle | None, str]:
    """Return what rolls along lines of a map; if that cannot be, why. With a file that was given, errors are raised.

    ``calibration``: the file that the map was made with; None: an included one; ``motion`` as of `LineVehicle.of`.
    """
    try:
        made = map_calibration(site.manifest, site.grid.tile_size, calibration)
        return LineVehicle.of(site, made, motion=motion), ""
    except (BadInputError, UsageError) as error:
        if calibration is not None:
            raise
        return None, str(error)


def with_line_ride(ground: CostGround, way: MeasuredWay, calibration: Path | None) -> tuple[MeasuredWay, list[str]]:
    """Add the ride of a way's own line to its figures and profile; return remarks too; see `line_vehicle`."""
    site = ground.site
    vehicle, why = line_vehicle(site, calibration)
    if vehicle is None:
        return way, [f"the ride of the line itself is not known: {why}"]
    if way.figures.length_m <= 0.0:
        return way, []
    found = ride_line(site, way.line, vehicle, _SIGMA_M)
    mean, low, high = found.over(0.0, math.inf)
    metre = np.clip(np.searchsorted(found.distance, way.profile.distance, side="right") - 1, 0, len(found.c_r) - 1)
    figures = replace(way.figures, c_r_line=mean, c_r_line_low=low, c_r_line_high=high)
    return replace(way, figures=figures, profile=replace(way.profile, c_r_line=found.c_r[metre])), []


def ride_line(site: MapReader, line: Floats, vehicle: LineVehicle, sigma: float) -> LineRide:
    """Roll a vehicle along a line, (m, 2) easting and northing [m]; see `ride_along`."""
    length = float(np.hypot(*np.diff(line, axis=0).T).sum())
    if length <= 0.0:
        raise UsageError("line: its length is 0")
    at = np.float64(vehicle.way) * (np.arange(max(int(np.ceil(length / vehicle.way - 1e-9)), 1)) + 0.5)
    metre = np.minimum(at.astype(np.int64), max(int(np.ceil(length - 1e-9)) - 1, 0))
    count = int(metre[-1]) + 1
    per, lead = int(_PIECE_M / vehicle.way), vehicle.way * np.arange(1, vehicle.reach + 1)
    across, weights = _across(sigma)
    sums = np.zeros((2 * len(across) + 5, count))
    for first in range(0, len(at), per):
        own, to = at[first : first + per], metre[first : first + per]
        # What is felt depends on the ground before and behind, at the ends of the line too.
        places = np.concatenate([own[0] - lead[::-1], own, own[-1] + lead])
        heights, touched, tiles = _roll(site, line, places, vehicle, across)
        inside = slice(len(lead), len(lead) + len(own))
        sums += [np.bincount(to, row[inside], count) for row in _felt(heights, touched, tiles, vehicle, weights)]
    felt, times, (of_tiles, rated, log_sd, seen, shaken) = np.split(sums, [len(across), 2 * len(across)])
    samples = np.bincount(metre)
    known = times > samples / 2
    by_line = np.asarray(known.any(axis=0))
    at_places = np.where(by_line, felt / np.maximum(times, 1.0), of_tiles / samples)
    share = weights[:, None] * (known | ~by_line)
    c_r = np.average(at_places, axis=0, weights=share)
    spread = np.sqrt(np.average((at_places - c_r) ** 2, axis=0, weights=share))
    ends = np.minimum(np.arange(count + 1.0), length)
    middle = points_along(line, (ends[1:] + ends[:-1]) / 2)
    x, y = site.to_crs(middle[:, 0], middle[:, 1])
    floor = vehicle.calibration.floor_at(vehicle.speed)
    return LineRide(
        speed_mps=vehicle.speed,
        distance=ends,
        floor=floor,
        x=x,
        y=y,
        c_r=with_floor(c_r, floor),
        log_sd=np.where(np.isfinite(c_r), log_sd / np.maximum(rated, 1.0), np.nan),
        log_sd_across=np.where(by_line, spread / np.maximum(c_r, _LEAST), _TILE_LOG_SD),
        a_w=np.sqrt(shaken / samples),
        by_line=by_line,
        seen=seen / samples,
        across=across,
        weights=weights,
        c_r_across=np.where(share > 0.0, with_floor(at_places, floor), np.nan),
    )


def _across(sigma: float) -> tuple[Floats, Floats]:
    """Return places across a line, (k,) m, and their weights, for an error of the place [m]."""
    if sigma <= _ALIKE_M:
        return sigma * np.array(_ACROSS), np.array(_WEIGHTS)
    reach = math.ceil(_MOST_SIGMA * sigma / _ALIKE_M)
    places = _ALIKE_M * np.arange(-reach, reach + 1.0)
    chance: Floats = np.exp(-0.5 * (places / sigma) ** 2)
    return places, chance / chance.sum()


class _Tiles(NamedTuple):
    """Values of tiles, or of the tiles that samples lie in, (n,) each; NaN where unknown."""

    c_r: Floats
    """At the profile's speed, less the floor, rad/m."""
    log_sd: Floats
    """Of ln ``c_r``, by its interval."""
    speed: Floats
    """C_r at the speed asked for over ``c_r``."""
    slope: Floats
    """Degrees."""
    reach: Floats
    """``belly_reach``."""
    left: Floats
    """Stated C_r over that of the denoised tile."""
    a_w: Floats
    """m/s2, at the speed asked for."""
    heave: Floats
    """The same of the geometry alone."""


class _LineWindow(NamedTuple):
    """The map about a stretch of a line."""

    heights: Floats
    """(rows * pixels, cols * pixels) m; larger holes are NaN."""
    touched: NDArray[np.bool_]
    """(rows, cols) tiles that wheels touch, that the middle of the vehicle is in, and those around them."""
    bands: Floats
    """(4, tiles) of these: ``c_r`` with its interval, slope."""
    tile: NDArray[np.int64]
    """(n,) which of these each sample is in."""
    wheels: Floats
    """(places across * 4, n, 2) row and column of wheels, pixels."""
    turn: NDArray[np.int64]
    """(places across * 4, n) their direction; see `wheel_turn`."""
    seen: Floats
    """(n,) share of the pixels under the wheels that hold points."""


def _roll(
    site: MapReader, line: Floats, at: Floats, vehicle: LineVehicle, across: Floats
) -> tuple[Floats, Floats, _Tiles]:
    """Roll the wheels over n samples along a line.

    Returns (places across, 4, n) lowest point of each wheel, m, without the jumps of their turns, NaN where unknown;
    (n,) share of the pixels under the wheels that hold points; the tiles in which the middle of the vehicle is.
    """
    pixels, parts = site.grid.pixels, _parts(site, line, at, max(int(_STRETCH_M / vehicle.way), 1))
    windows = [_read(site, *_places(line, part, vehicle.operator, across), vehicle) for part in parts]
    boxes = [tiles_of(window.heights, pixels) for window in windows]
    bands = np.concatenate([window.bands for window in windows], axis=1)
    own, slope = _own_speed(bands, vehicle), np.nan_to_num(bands[3]).astype(np.float64)
    noise = match_noise(_relief(boxes, windows), own, slope, vehicle.correction, vehicle.operator)
    ends = np.cumsum([window.bands.shape[1] for window in windows])
    for window, found in zip(windows, np.split(noise, ends[:-1]), strict=True):
        of_tiles = np.full(window.touched.shape, np.nan)
        of_tiles[window.touched] = found
        window.heights[...] += smooth_over(window.heights, of_tiles, pixels)
    inside = np.concatenate([np.isin(np.arange(window.bands.shape[1]), window.tile) for window in windows])
    tiles = _rated(_relief(boxes, windows), own, slope, bands, inside, vehicle)
    rolled, turn = [], None
    for window, last in zip(windows, ends, strict=True):
        here = slice(last - window.bands.shape[1], last)
        before = np.column_stack([window.turn[:, :1] if turn is None else turn[:, -1:], window.turn[:, :-1]])
        turn = window.turn
        low, jump = roll_wheels(window.heights, window.wheels, turn, before, vehicle.operator)
        rolled.append((low, jump, window.seen, *(values[here][window.tile] for values in tiles)))
    low, jump, seen, *columns = (np.concatenate(parts, axis=-1) for parts in zip(*rolled, strict=True))
    return (low - np.cumsum(jump, axis=1)).reshape(len(across), 4, -1), seen, _Tiles(*columns)


def _parts(site: MapReader, line: Floats, at: Floats, per: int) -> list[Floats]:
    """Cut distances along a line, (n,) m, into parts of some times ``per`` that one window of the map each will do."""
    firsts, own, spanned, places = [0], 0, np.empty((0, 2)), _on_line(line, at)
    for first in range(0, len(at), per):
        ends = np.column_stack([(axis.min(), axis.max()) for axis in places[first : first + per].T])
        spanned = np.concatenate([spanned, ends])
        alone, together = (window.rows * window.cols for window in (window_around(site, x, 1) for x in (ends, spanned)))
        own += alone
        if first and together > min(_WINDOW_TILES, 2 * own):
            firsts, own, spanned = [*firsts, first], alone, ends
    return np.split(at, firsts[1:])


def _read(site: MapReader, middle: Floats, wheels: Floats, vehicle: LineVehicle) -> _LineWindow:
    from scipy.ndimage import maximum_filter

    grid = site.grid
    # A wheel reaches as far as its radius, and the heights between pixels one farther.
    beside = (vehicle.calibration.vehicle["wheel"]["radius_m"] + grid.pixel_size) / grid.tile_size
    window = window_around(site, wheels.reshape(-1, 2), 3 + int(beside))
    objects = site.objects(window)
    measured = site.heights(window).astype(np.float64)
    measured[(objects == OBSTACLE) | (objects == CANOPY)] = np.nan
    where = in_window(wheels.reshape(-1, 2), grid, window)
    # Inside the window no number is below 0, and a whole number is the floor.
    pixels = where * grid.pixels
    seen = np.isfinite(measured[tuple(pixels.astype(np.int64).T)]).reshape(-1, wheels.shape[2]).mean(axis=0)
    touched = np.zeros((window.rows, window.cols), np.bool_)
    own = tuple(in_window(middle, grid, window).astype(np.int64).T)
    touched[own] = True
    reached = [(where + off).astype(np.int64).T for off in (-beside, beside)]
    for rows, cols in product(*zip(*reached, strict=True)):
        touched[rows, cols] = True
    touched = np.asarray(maximum_filter(touched, 3))  # what is taken off a tile hangs on the noise beside it
    found = site.values(window, _BANDS)
    bands = np.array([found[name][touched] for name in _BANDS])
    number = np.cumsum(touched).reshape(touched.shape) - 1
    # Holes in a tile that no wheel touches fill those beside it.
    near = np.asarray(maximum_filter(touched, 3))
    filled = np.pad(measured, 1, mode="edge")
    loops.fill_near_holes(filled, near, _FILL_ROUNDS)
    east, north = np.moveaxis(wheels[:, :1] - wheels[:, 2:3], -1, 0)
    # Rows count southwards.
    turn = np.broadcast_to(wheel_turn(np.arctan2(-north, east)), wheels.shape[:3]).reshape(-1, wheels.shape[2])
    places = pixels.reshape(*turn.shape, 2)
    return _LineWindow(filled[1:-1, 1:-1].copy(), touched, bands, number[own], places, turn, seen)


def _relief(boxes: Sequence[Floats], windows: Sequence[_LineWindow]) -> NDArray[np.float32]:
    """Return the relief of the touched tiles of all windows, (n, pixels, pixels) m."""
    touched = [box[window.touched] for box, window in zip(boxes, windows, strict=True)]
    return remove_plane(np.concatenate(touched)).astype(np.float32)


def _own_speed(bands: NDArray[np.float32], vehicle: LineVehicle) -> Floats:
    """Return C_r of n tiles at the profile's speed, less the floor, (n,) rad/m."""
    calibration, moving = vehicle.calibration, vehicle.moving
    if moving is None:
        return less_floor(bands[0], calibration.map_floor)
    nothing = np.full((bands.shape[1], 2 * len(moving.speeds)), np.nan, np.float32)
    own = motion_felt(calibration, moving.speeds, nothing, bands[0])[:, 0].astype(np.float64)
    return less_floor(own, calibration.floor_at(moving.speeds[0]))


def _rated(
    clean: NDArray[np.float32],
    own: Floats,
    slope: Floats,
    bands: NDArray[np.float32],
    inside: Mask,
    vehicle: LineVehicle,
) -> _Tiles:
    """Return what is known of n tiles whose relief is ``clean``, (n, pixels, pixels) m.

    ``inside`` (n,): the middle of the vehicle is in them; of the others, speed and acceleration are not needed.
    """
    calibration, moving = vehicle.calibration, vehicle.moving
    rides = roll_over(clean, vehicle.operator)
    left = np.maximum(own, _LEAST) / np.exp(vehicle.correction.without_noise(rides, slope))
    ratio, a_w, heave = np.ones(len(own)), np.full(len(own), np.nan), np.full(len(own), np.nan)
    if moving is not None:
        speeds, at = moving.speeds, moving.speeds.index(vehicle.speed)
        motions = move_over(np.where(inside[:, None, None], clean, np.float32(np.nan)), moving)
        _, factors = motion_factors(calibration, speeds, motions, rides.pitch_change)
        felt = motion_felt(calibration, speeds, factors, bands[0]).astype(np.float64)
        ratio = less_floor(felt[:, 2 * at], calibration.floor_at(vehicle.speed)) / np.maximum(own, _LEAST)
        a_w, heave = felt[:, 2 * at + 1], motions.heave[:, at]
    c_r, low, high = (less_floor(values, calibration.map_floor) for values in bands[:3])
    sides = np.nan_to_num(interval_log_sd(c_r, low, high, vehicle.drive_log_sd))
    log_sd = np.where(np.isfinite(c_r), sides.mean(axis=0), np.nan)
    return _Tiles(own, log_sd, ratio, slope, rides.belly_reach, np.where(np.isfinite(left), left, 1.0), a_w, heave)


def _places(line: Floats, at: Floats, operator: RideOperator, across: Floats) -> tuple[Floats, Floats]:
    """Return the middle of the vehicle, (n, 2), and its wheels, (places, 4, n, 2), easting and northing, m.

    Beyond its ends the line goes straight on.
    """
    front, rear = (_on_line(line, at + way) for way in (operator.wheelbase / 2, -operator.wheelbase / 2))
    ahead = front - rear
    ahead /= np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    middle = (front + rear) / 2
    axle = np.where(_SIDES[:, 0, None, None] > 0, front, rear)
    beside = across[:, None] + operator.track / 2 * _SIDES[:, 1]
    return middle, axle + beside[:, :, None, None] * left


def _on_line(line: Floats, at: Floats) -> Floats:
    length = float(np.hypot(*np.diff(line, axis=0).T).sum())
    inside = points_along(line, np.clip(at, 0.0, length))
    step = np.diff(line, axis=0)
    moving = step[np.hypot(*step.T) > 0]
    start, end = (way / np.hypot(*way) for way in (moving[0], moving[-1]))
    beyond: Floats = np.minimum(at, 0.0)[:, None] * start + np.maximum(at - length, 0.0)[:, None] * end
    return inside + beyond


def _felt(heights: Floats, seen: Floats, tile: _Tiles, vehicle: LineVehicle, weights: Floats) -> Floats:
    """Return what is felt at n samples from `_roll`, (2 k + 5, n): rows that are added up metre by metre.

    C_r at each of k places across, 0 where a wheel meets ground that is not known; where it does not; C_r of the tile;
    where that is known; the error of its logarithm, else 0; what is seen; the square of the acceleration.
    """
    calibration = vehicle.calibration
    front_left, front_right, rear_left, rear_right = np.moveaxis(heights, 1, 0)
    pitches = (front_left + front_right - rear_left - rear_right) / (2 * vehicle.operator.wheelbase)
    is_felt = np.isfinite(pitches) & np.isfinite(tile.c_r) & np.isfinite(tile.reach)
    reach, slope, stretch = np.nan_to_num(tile.reach), np.nan_to_num(tile.slope), calibration.tile_size
    felt = felt_along(_bridged(pitches), vehicle.taps, vehicle.way, stretch, reach, slope, vehicle.correction)
    shaken = np.full_like(tile.c_r, np.nan)
    if vehicle.moving is not None:
        taps, _ = heave_filter(vehicle.speed, vehicle.way)
        lifts = np.pad(_bridged(heights.mean(axis=1)), ((0, 0), (len(taps) // 2,) * 2), mode="edge")
        known = is_felt & (tile.heave > 0)
        heaves = np.abs([np.convolve(lift, taps, "valid") for lift in lifts])
        share = np.where(known, heaves / np.where(known, tile.heave, 1.0), 1.0)
        shaken = np.average((tile.a_w * share) ** 2, axis=0, weights=weights)
    c_r = np.where(is_felt, tile.speed * felt * tile.left, 0.0)
    rated = np.isfinite(tile.log_sd)
    log_sd = np.where(rated, tile.log_sd, 0.0)
    return np.vstack([c_r, is_felt, tile.speed * tile.c_r, rated, log_sd, seen, shaken])


def _bridged(lines: Floats) -> Floats:
    """Interpolate over the unknown samples of each line, (k, n); 0 if none is known."""
    at, found = np.arange(lines.shape[1]), np.zeros_like(lines)
    for line, values in zip(found, lines, strict=True):
        known = np.isfinite(values)
        if known.any():
            line[:] = np.interp(at, at[known], values[known])
    return found
