"""The ground beside steps: what of a tile is left for a vehicle where a step, drop or ditch closes a part of it.

A tile with a ditch in it fails as a whole, and so would the bridge over it. So the pixels of steps that the vehicle
cannot cross are taken out, with those beside them, which may hold a part of its face. What is left falls into areas
that hang together; each has a slope of its own, and what is left after the planes of all of them are removed is the
relief that the ride model rolls over. Noise is taken off as in the rating of whole tiles; it is estimated from pairs
of points, because the spread of each pixel is not kept.
"""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import FAIL_SHARE, Floats, Mask, loops, obstacle_reach
from bumpymap.rating.calibration import Calibration, remembered
from bumpymap.rating.ride.motion_operator import roll_over
from bumpymap.rating.ride.rate import RideModel, interval, take_noise_off
from bumpymap.rating.ride.speed import plain_speed_factor, speed_log_sd
from bumpymap.rating.ride.thin import THIN_COLUMNS

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
