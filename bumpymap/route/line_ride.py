"""The ride of one line: the vehicle rolled along it over the pixels of a map.

The ride cost of a tile is the mean over all headings and places; a vehicle drives one line. The heights of the tiles
that its wheels touch are denoised just so far that their predicted C_r is the one that the map states (`match_tiles`).
The wheels roll along the line over these heights, across the borders of tiles, and the change of the chassis' pitch is
turned into C_r by the correction that the drives of the calibration taught (`felt_along`). Where a wheel meets ground
whose height is not known, the metre has the ride cost of its tile.

The axles follow the line, half a wheelbase before and behind each sample, and the wheels stand beside them at right
angles to the vehicle. Where the vehicle is across the line is known to ``sigma``: it is rolled at three places, those
of Gauss-Hermite quadrature.
"""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CANOPY, OBSTACLE, BadInputError, UsageError, path_of_call
from bumpymap.layers import NORMAL_80, MapReader, PlannedRoute, common_window, open_map
from bumpymap.rating import (
    Calibration,
    Correction,
    RideOperator,
    SpeedRating,
    at_speed,
    chassis_response,
    felt_along,
    find_calibration,
    heave_filter,
    less_floor,
    match_tiles,
    motion_felt,
    move_over,
    remove_plane,
    with_floor,
)
from bumpymap.route.ground import points_along, window_around
from bumpymap.route.places import in_window
from bumpytiles import TileWindow

__all__ = ["LineRide", "ride_along", "with_line_rides"]

Floats = NDArray[np.float64]

_SIGMA_M = 0.3
"""Standard deviation of where a vehicle is across its line, m."""
_ACROSS = (-math.sqrt(3.0), 0.0, math.sqrt(3.0))
"""Places across the line, standard deviations, and their weights."""
_WEIGHTS = (1 / 6, 2 / 3, 1 / 6)
_ACROSS_NAMES = ("right", "middle", "left")
_SAMPLED = ("log_sd", "told", "seen", "shaken")
_STRETCH_M = 90.0
"""Length whose window of the map is read at once."""
_PIECE_M = 2000.0
"""Length that is computed at once."""
_TILE_LOG_SD = 1.2
"""Standard deviation of ln C_r of a metre of a line about that of its tile: 0.4 over 10 m. The width that holds 80 % of
simulated drives along such lines (``tests/benchmarks/line_drives.py``) is 0.39 on the sample, 0.28 on a real survey."""
_FILL_ROUNDS = 3
"""Holes of up to twice as many pixels are filled with the mean of their neighbours."""
_LEAST = 1e-5
"""C_r below this is none, rad/m."""
_RIDE = ("c_r", "c_r_low", "c_r_high")
_COLUMNS = ("c_r", "log_sd", "speed", "slope", "reach", "left", "a_w", "heave")
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
    """(n,) whether the pixels told it; else it is the value of the tiles."""
    seen: Floats
    """(n,) share of the places of wheels, 0..1, whose pixel holds points."""

    @property
    def pitch_rate(self) -> Floats:
        """(n,) mean size of the pitch rate, rad/s."""
        return self.c_r * self.speed_mps

    def over(self, first: float, last: float) -> tuple[float, float, float]:
        """Return C_r of what is known between two distances [m], and both ends of its 80 % interval, rad/m.

        NaN if nothing is known there.
        """
        part = np.clip(np.minimum(self.distance[1:], last) - np.maximum(self.distance[:-1], first), 0.0, None)
        known = np.isfinite(self.c_r) & (part > 0.0)
        if not known.any():
            return (np.nan, np.nan, np.nan)
        share = part[known] / part[known].sum()
        bare = less_floor(self.c_r[known], self.floor)
        # The model of the vehicle errs alike in all tiles, the place across differs from metre to metre.
        weight = share * bare / max(float((share * bare).sum()), 1e-12)
        of_place = np.sqrt(((weight * self.log_sd_across[known]) ** 2).sum())
        wide = np.exp(NORMAL_80 * np.hypot((weight * self.log_sd[known]).sum(), of_place))
        mean, low, high = (float((share * with_floor(bare * by, self.floor)).sum()) for by in (1.0, 1.0 / wide, wide))
        return mean, low, high


class _Vehicle(NamedTuple):
    """A vehicle and its calibration, ready to roll."""

    calibration: Calibration
    correction: Correction
    operator: RideOperator
    rating: SpeedRating | None
    """At the profile's speed and at the one asked for."""
    speed: float
    """m/s."""
    way: float
    """Distance between samples, m."""
    taps: Floats
    """How the chassis follows its rockers."""
    reach: int
    """Samples to either side that what is felt depends on."""


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
    made = map_calibration(site, None if calibration is None else Path(path_of_call("calibration", calibration)))
    with site.kept_open():
        return _ride(site, on_grid, _vehicle_at(site, made, wanted), across)


def map_calibration(site: MapReader, file: Path | None) -> Calibration:
    """Return the calibration that a map was made with: a file, or an included one.

    Raises
    ------
    BadInputError
        It is another one, or no included one.
    UsageError
        The tiles were not rated by their ride.
    """
    rated = site.manifest["settings"]
    if (rated.get("rating", "ride"), rated.get("compat", "none")) != ("ride", "none"):
        raise UsageError("the tiles of this map were not rated by their ride; map the survey with `rating='ride'`")
    about: Mapping[str, Any] = site.manifest["vehicle"]
    speed = None if "drives_mps" not in about else float(about["speed_mps"])
    name, side = str(about["name"]), site.grid.tile_size
    try:
        found = at_speed(find_calibration(name, file, side), speed)
    except UsageError as error:
        if file is not None:
            raise
        raise BadInputError(f"the map was made for {name}, which is no included vehicle: {error}") from error
    if found.id != site.calibration_id:
        raise BadInputError(
            f"the map was made with the calibration {site.calibration_id}, and {file or name} is {found.id}. "
            "Give the file of that one as `calibration`, or map the survey again"
        )
    return found


def with_line_rides(site: MapReader, routes: Sequence[PlannedRoute]) -> tuple[list[PlannedRoute], str | None]:
    """Add the ride of each way's own line to its figures and profile; if that cannot be, return why."""
    try:
        vehicle = _vehicle_at(site, map_calibration(site, None), None, motion=False)
    except BadInputError:
        return list(routes), (
            "the ride of the line itself needs the calibration of the map, which is not an included one. In Python: "
            "bumpymap.ride_along(LAYERS, LINE, calibration=FILE)"
        )
    except UsageError as error:
        return list(routes), f"the ride of the line itself is not known: {error}"
    return [_with_line_ride(site, route, vehicle) for route in routes], None


def _with_line_ride(site: MapReader, route: PlannedRoute, vehicle: "_Vehicle") -> PlannedRoute:
    if route.figures.length_m <= 0.0:
        return route
    found = _ride(site, route.line, vehicle, _SIGMA_M)
    mean, low, high = found.over(0.0, math.inf)
    metre = np.clip(np.searchsorted(found.distance, route.profile.distance, side="right") - 1, 0, len(found.c_r) - 1)
    return replace(
        route,
        figures=replace(route.figures, c_r_line=mean, c_r_line_low=low, c_r_line_high=high),
        profile=replace(route.profile, c_r_line=found.c_r[metre]),
    )


def _ride(site: MapReader, line: Floats, vehicle: "_Vehicle", sigma: float) -> LineRide:
    calibration = vehicle.calibration
    length = float(np.hypot(*np.diff(line, axis=0).T).sum())
    if length <= 0.0:
        raise UsageError("line: its length is 0")
    at = np.float64(vehicle.way) * (np.arange(max(int(np.ceil(length / vehicle.way - 1e-9)), 1)) + 0.5)
    metre = np.minimum(at.astype(np.int64), max(int(np.ceil(length - 1e-9)) - 1, 0))
    count = int(metre[-1]) + 1
    samples, sums = np.bincount(metre, minlength=count), dict.fromkeys((*_ACROSS_NAMES, *_SAMPLED), np.zeros(count))
    per, lead = int(_PIECE_M / vehicle.way), vehicle.way * np.arange(1, vehicle.reach + 1)
    for first in range(0, len(at), per):
        own = at[first : first + per]
        # What is felt depends on the ground before and behind, at the ends of the line too.
        places = np.concatenate([own[0] - lead[::-1], own, own[-1] + lead])
        inside = slice(len(lead), len(lead) + len(own))
        for name, values in _felt(_roll(site, line, places, vehicle, sigma), vehicle).items():
            sums[name] = sums[name] + np.bincount(metre[first : first + per], values[inside], count)
    mean = {name: total / samples for name, total in sums.items()}
    across = np.array([mean[name] for name in _ACROSS_NAMES])
    c_r = np.average(across, axis=0, weights=_WEIGHTS)
    spread = np.sqrt(np.average((across - c_r) ** 2, axis=0, weights=_WEIGHTS))
    ends = np.minimum(np.arange(count + 1.0), length)
    middle = points_along(line, (ends[1:] + ends[:-1]) / 2)
    x, y = site.to_crs(middle[:, 0], middle[:, 1])
    by_line, floor = mean["told"] > 0.5, calibration.floor_at(vehicle.speed)
    return LineRide(
        speed_mps=vehicle.speed,
        distance=ends,
        floor=floor,
        x=x,
        y=y,
        c_r=with_floor(c_r, floor),
        log_sd=mean["log_sd"],
        log_sd_across=np.where(by_line, spread / np.maximum(c_r, _LEAST), _TILE_LOG_SD),
        a_w=np.sqrt(mean["shaken"]),
        by_line=by_line,
        seen=mean["seen"],
    )


def _vehicle_at(site: MapReader, calibration: Calibration, speed: float | None, *, motion: bool = True) -> _Vehicle:
    """Make what rolling takes; without ``motion`` the vertical acceleration is not needed."""
    grid, own = site.grid, float(calibration.vehicle["speed_mps"])
    calibration.require_grid(grid.tile_size, grid.pixels)
    if calibration.ride is None:
        raise UsageError(f"the calibration {calibration.id} holds no ride model. Make one with: bumpymap calibrate")
    wanted = calibration.map_speed if speed is None else speed
    if wanted != calibration.map_speed:
        at_speed(calibration, wanted)  # refuses what it cannot tell
    operator = RideOperator.of(calibration.vehicle, grid.tile_size, grid.pixels)
    needed = calibration.motion is not None and (motion or not wanted == own == calibration.map_speed)
    rating = SpeedRating.of(calibration, tuple(dict.fromkeys((own, wanted)))) if needed else None
    way = grid.pixel_size / operator.fine / 2
    taps = chassis_response(calibration.vehicle, way)
    stretch = math.ceil(grid.tile_size / 2 / way)
    reach = len(taps) + max(stretch, len(heave_filter(wanted, way)[0]) // 2 if rating is not None else 0)
    correction = Correction.from_record(calibration.ride)
    return _Vehicle(calibration, correction, operator, rating, wanted, way, taps, reach)


class _Rolled(NamedTuple):
    """Samples along a line."""

    heights: Floats
    """(places, 4, n) lowest point of each wheel at each place across, m; NaN where unknown."""
    seen: Floats
    """(n,) share of the pixels under the wheels that hold points."""
    tile: dict[str, Floats]
    """Of the tile that the middle of the vehicle is in, (n,) each: ``c_r`` at the profile's speed, its ``log_sd``, the
    ``speed`` asked for over it, ``slope``, ``reach``, what denoising has ``left`` to the stated C_r as a factor,
    ``a_w`` and geometric ``heave`` at the speed."""


def _roll(site: MapReader, line: Floats, at: Floats, vehicle: _Vehicle, sigma: float) -> _Rolled:
    across, grid = sigma * np.array(_ACROSS), site.grid
    heights, seen = np.empty((len(across), 4, len(at))), np.empty(len(at))
    tile = {name: np.empty(len(at)) for name in _COLUMNS}
    per = max(int(_STRETCH_M / vehicle.way), 1)
    for first in range(0, len(at), per):
        part = slice(first, first + per)
        middle, wheels = _places(line, at[part], vehicle.operator, across)
        window = window_around(site, wheels.reshape(-1, 2), 1)
        if common_window(site.window, window) is None:
            heights[:, :, part], seen[part] = np.nan, 0.0
            for values in tile.values():
                values[part] = np.nan
            continue
        # The heights of what stands on the ground are not the ground's.
        stands = np.isin(site.objects(window), (OBSTACLE, CANOPY))
        measured = np.where(stands, np.nan, site.heights(window).astype(np.float64))
        where = in_window(wheels.reshape(-1, 2), grid, window)
        row, col = np.floor(where * grid.pixels).astype(np.int64).T
        seen[part] = np.isfinite(measured[row, col]).reshape(-1, wheels.shape[2]).mean(axis=0)
        touched = np.zeros((window.rows, window.cols), np.bool_)
        # A wheel reaches as far as its radius, and the heights between pixels one farther.
        beside = (vehicle.calibration.vehicle["wheel"]["radius_m"] + grid.pixel_size) / grid.tile_size
        for row, col in product((-beside, beside), repeat=2):
            touched[tuple(np.floor(where + np.array([row, col])).astype(np.int64).T)] = True
        clean, columns = _matched(site, window, _filled(measured), touched, vehicle)
        heights[:, :, part] = _envelope(clean, where * grid.pixels, vehicle.operator).reshape(len(across), 4, -1)
        own = tuple(np.floor(in_window(middle, grid, window)).astype(np.int64).T)
        for name, values in columns.items():
            tile[name][part] = values[own]
    return _Rolled(heights, seen, tile)


def _matched(
    site: MapReader, window: TileWindow, heights: Floats, touched: NDArray[np.bool_], vehicle: _Vehicle
) -> tuple[Floats, dict[str, Floats]]:
    """Take the noise off the tiles that are touched; return heights of the window, and columns of its tiles."""
    calibration, pixels = vehicle.calibration, site.grid.pixels
    found = site.values(window, (*_RIDE, "slope"))
    c_r, low, high = (less_floor(found[name][touched], calibration.map_floor) for name in _RIDE)
    slope = np.nan_to_num(found["slope"][touched]).astype(np.float64)
    tiles = heights.reshape(window.rows, pixels, window.cols, pixels).transpose(0, 2, 1, 3).copy()
    relief = remove_plane(tiles[touched]).astype(np.float32)
    if vehicle.rating is None:
        own, ratio, a_w, heave = c_r, np.ones(len(c_r)), np.full(len(c_r), np.nan), np.full(len(c_r), np.nan)
        matched = match_tiles(relief, own, slope, vehicle.correction, vehicle.operator)
    else:
        speeds = vehicle.rating.speeds
        level = np.full((len(c_r), 3 * len(speeds)), np.nan, np.float32)
        own = motion_felt(calibration, speeds, level, found["c_r"][touched])[:, 0].astype(np.float64)
        own = less_floor(own, calibration.floor_at(speeds[0]))
        matched = match_tiles(relief, own, slope, vehicle.correction, vehicle.operator)
        _, factors = vehicle.rating.factors(matched.relief_map, matched.rides.pitch_change)
        felt = motion_felt(calibration, speeds, factors, found["c_r"][touched]).astype(np.float64)
        ratio = less_floor(felt[:, -3], calibration.floor_at(vehicle.speed)) / np.maximum(own, _LEAST)
        a_w = felt[:, -1]
        heave = move_over(matched.relief_map, vehicle.rating.operator).heave[:, len(speeds) - 1]
    tiles[touched] += matched.relief_map - relief
    known = (low > 0.0) & (high > 0.0)
    log_sd = np.where(np.isfinite(c_r), np.log(np.where(known, high / np.where(known, low, 1.0), 1.0)), np.nan)
    log_sd /= 2 * NORMAL_80
    columns = {}
    values_of = (own, log_sd, ratio, slope, matched.rides.belly_reach, matched.left, a_w, heave)
    for name, values in zip(_COLUMNS, values_of, strict=True):
        columns[name] = np.full(touched.shape, np.nan)
        columns[name][touched] = values
    return tiles.transpose(0, 2, 1, 3).reshape(heights.shape), columns


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


def _filled(heights: Floats) -> Floats:
    """Fill holes with the mean of their neighbours, round by round; larger ones stay NaN."""
    from scipy.ndimage import uniform_filter

    filled = heights
    for _ in range(_FILL_ROUNDS):
        hole = np.isnan(filled)
        if not hole.any():
            break
        share = uniform_filter((~hole).astype(np.float64), 3, mode="nearest")
        total = uniform_filter(np.where(hole, 0.0, filled), 3, mode="nearest")
        with np.errstate(invalid="ignore", divide="ignore"):
            filled = np.where(hole & (share > 0.1), total / share, filled)
    return filled


def _envelope(heights: Floats, where: Floats, operator: RideOperator) -> Floats:
    """Return the lowest point of wheels at places, (n,), m: row and column in pixels from the north-west corner."""
    fine, wheel = operator.fine, operator.wheel
    nodes = _nodes(heights, fine)
    place = where * fine
    corner = np.floor(place).astype(np.int64)
    part = place - corner
    cols = nodes.shape[1]
    flat = (corner[:, 0, None] + (0, 0, 1, 1)) * cols + corner[:, 1, None] + (0, 1, 0, 1)
    values = nodes.ravel()
    is_touched = np.zeros(len(values), np.bool_)
    is_touched[flat] = True
    touched = np.flatnonzero(is_touched)
    low = np.full(len(touched), -np.inf)
    for row, col, rise in zip(wheel.row.tolist(), wheel.col.tolist(), wheel.rise.tolist(), strict=True):
        np.maximum(low, values[touched + (row * cols + col)] + rise, out=low)
    envelope = np.empty(len(values))
    envelope[touched] = low
    corners = envelope[flat]
    south, east = part[:, 0], part[:, 1]
    weight = np.column_stack([(1 - south) * (1 - east), (1 - south) * east, south * (1 - east), south * east])
    low_point: Floats = (corners * weight).sum(axis=1)
    return low_point


def _nodes(heights: Floats, fine: int) -> Floats:
    """Return bilinear heights at the corners of pixels and between them, ``fine`` a pixel."""
    for axis in (0, 1):
        count = heights.shape[axis]
        place = np.clip(np.arange(count * fine + 1) / fine - 0.5, 0, count - 1)
        low = np.minimum(place.astype(np.int64), count - 2)
        part = (place - low)[(slice(None), None) if axis == 0 else (None, slice(None))]
        first, second = np.take(heights, low, axis), np.take(heights, low + 1, axis)
        heights = first + (second - first) * part
    return heights


def _felt(rolled: _Rolled, vehicle: _Vehicle) -> dict[str, Floats]:
    """Return what is felt at each sample, (n,) each: C_r at each place across, and what `_SAMPLED` names."""
    tile, calibration = rolled.tile, vehicle.calibration
    front_left, front_right, rear_left, rear_right = np.moveaxis(rolled.heights, 1, 0)
    pitches = (front_left + front_right - rear_left - rear_right) / (2 * vehicle.operator.wheelbase)
    told = np.isfinite(pitches).all(axis=0) & np.isfinite(tile["c_r"]) & np.isfinite(tile["reach"])
    reach, slope = np.nan_to_num(tile["reach"]), np.nan_to_num(tile["slope"])
    found: dict[str, Floats] = {"log_sd": tile["log_sd"], "told": told.astype(np.float64), "seen": rolled.seen}
    shaken = np.zeros(len(told))
    for name, weight, pitch, lift in zip(_ACROSS_NAMES, _WEIGHTS, pitches, rolled.heights.mean(axis=1), strict=True):
        stretch = calibration.tile_size
        felt = felt_along(_bridged(pitch), vehicle.taps, vehicle.way, stretch, reach, slope, vehicle.correction)
        found[name] = tile["speed"] * np.where(told, felt * tile["left"], tile["c_r"])
        if vehicle.rating is not None:
            known = told & (tile["heave"] > 0)
            share = np.where(known, _heave(_bridged(lift), vehicle) / np.where(known, tile["heave"], 1.0), 1.0)
            shaken += weight * (tile["a_w"] * share) ** 2
    return found | {"shaken": shaken if vehicle.rating is not None else np.full(len(told), np.nan)}


def _bridged(values: Floats) -> Floats:
    """Interpolate over unknown samples; 0 if none is known."""
    known = np.isfinite(values)
    if known.all() or not known.any():
        return values if known.any() else np.zeros_like(values)
    at = np.arange(len(values))
    return np.interp(at, at[known], values[known])


def _heave(lift: Floats, vehicle: _Vehicle) -> Floats:
    """Return the size of the weighted vertical acceleration at each sample, (n,) m/s2."""
    taps, _ = heave_filter(vehicle.speed, vehicle.way)
    reach = len(taps) // 2
    return np.abs(np.convolve(np.pad(lift, reach, mode="edge"), taps, "valid"))
