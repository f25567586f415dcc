"""Explain that there is no way between two points: the widest opening, or the place where both sides come closest."""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import ndimage

from bumpymap.core import BARRED_TEXT, OBSTACLE, Barred, Floats, density_for
from bumpymap.layers import STEP_LINE
from bumpymap.route.ground import PIXEL_MARGIN, CostGround, window_around
from bumpymap.route.passages import BYTES_PER_TILE, first_pad
from bumpymap.route.places import on_grid, overlap, place_in_window
from bumpymap.route.planner import Planner
from bumpymap.route.search import find_way, spread
from bumpymap.route.stops import place_text
from bumpymap.views import area
from bumpytiles import TileWindow

_LEAST_OPENING, _TOO_NARROW = 1.5, 100.0
"""Least distance from what closes an opening, pixels: what is narrower is a gap between points. And cost of a pixel in
which the vehicle does not fit, so that a line leads through few of them (chosen)."""


def what_closes(ground: CostGround, start: Floats, goal: Floats) -> str:
    """Say where the widest opening between two points [m] is; without one, where the two sides come closest.

    Empty if memory does not allow to look for either. If the limit of slopes across is to blame, that is said instead.
    """
    if why := _barred_by_setting(ground, start, goal):
        return why
    needed, found = 2.0 * ground.site.vehicle.reach_m, widest_opening(ground, start, goal)
    if found is not None and found[1] < needed:
        place, width = found
        return (
            f"The widest opening between them is at {place_text(ground.site, place)}, about {width:.1f} m wide; the "
            f"vehicle needs {needed:.1f} m. "
        )
    site, window, grid = ground.site, ground.site.window, ground.site.grid
    if window.cols * window.rows > ground.memory_tiles:
        return ""
    ends = [place_in_window(end, grid, window) for end in (start, goal)]
    for through in (False, True):  # a point between obstacles lies in a tile that is closed as a whole
        cost = ground.on_tiles(window, through=through)
        first, second = (np.isfinite(spread(cost, end, margin=ground.margin)[0]) for end in ends)
        if first.any() and second.any():
            break
    else:
        return ""
    if (first & second).any():
        return f"The obstacles between them leave no opening as wide as the vehicle needs, {needed:.1f} m. "
    apart, (rows, cols) = ndimage.distance_transform_edt(~second, return_indices=True)
    row, col = np.unravel_index(np.where(first, apart, np.inf).argmin(), first.shape)
    closest = np.array([[row, col], [rows[row, col], cols[row, col]]]) + 0.5
    middle = on_grid(closest.mean(axis=0)[None], grid, window)[0]
    code = int(site.read(TileWindow.around(*grid.index(middle)[:, None]), ()).barred[0, 0])
    why = BARRED_TEXT[Barred(code)] if code in BARRED_TEXT and code != Barred.NO else "no passable ground"
    return (
        f"Both sides come closest at {place_text(site, middle)}, {math.dist(*closest) * grid.tile_size:.0f} m from "
        f"tile to tile, where there is: {why}. "
    )


def name_zones(ground: CostGround, start: Floats, goal: Floats) -> str:
    """Say in which zones two points [m] lie; empty if they lie in one, if it is not known, or memory does not allow."""
    site, window = ground.site, ground.site.window
    zones = [site.zone_at(end) for end in (start, goal)]
    if 0 in zones or zones[0] == zones[1] or window.cols * window.rows > ground.memory_tiles:
        return ""
    found = site.values(window, ("zone",))
    open_zones, tile_m2 = found["zone"][found["barred"] == Barred.NO], site.grid.tile_size**2
    first, second = (f"{area(tile_m2 * np.count_nonzero(open_zones == zone))} (zone {zone})" for zone in zones)
    return f"They lie on pieces of ground that nothing joins: of {first} and of {second}. "


def _barred_by_setting(ground: CostGround, start: Floats, goal: Floats) -> str:
    """Say which setting, and it alone, closes every way between two points; empty if none does."""
    settings, pixel_m = ground.settings, ground.site.grid.pixel_size
    if settings.side_limit is not None and _joined(ground, start, goal, side_limit=None):
        limit = f"{settings.side_limit:g} degrees"
        return f"Every way between them crosses slopes of more than {limit}: raise `side_limit` to find one. "
    if settings.seen_width is not None and _joined(ground, start, goal, seen_width=None):
        width, in_relief = settings.seen_width, not ground.site.manifest.get("ground_only")
        return (
            f"Every way between them crosses ground where objects of {width:g} m would not be seen: that takes "
            f"{density_for(width, pixel_m, in_relief=in_relief):,.0f} points/m2, evenly spread. Survey it again, or "
            "raise `seen_width`. "
        )
    return ""


def _joined(ground: CostGround, start: Floats, goal: Floats, **settings: Any) -> bool:
    """Return whether there is a way between two points with other settings."""
    other = replace(ground, settings=replace(ground.settings, **settings))
    return Planner(other).line(start, goal) is not None


def widest_opening(ground: CostGround, start: Floats, goal: Floats) -> tuple[Floats, float] | None:
    """Find the widest opening that is too narrow for the vehicle and joins two points that are not joined otherwise.

    ``start``, ``goal`` (2,): easting and northing, m; the vehicle fits there. Returns its narrowest point, (2,) easting
    and northing, and the width between the pixels that close it, m; None if all openings around the two points are
    narrower than 0.4 m (of pixels of 0.2 m), or memory does not allow to look for one.
    """
    pad = first_pad(ground, start, goal)
    window = overlap(window_around(ground.site, np.array([start, goal]), pad), ground.site.window)
    if window.rows * window.cols * BYTES_PER_TILE > ground.memory_bytes:
        return None
    pixels, pixel = ground.site.grid.pixels, ground.site.grid.pixel_size
    closed = np.repeat(np.repeat(np.isinf(ground.on_tiles(window)), pixels, 0), pixels, 1)
    closed |= np.isin(ground.site.objects(window), (OBSTACLE, STEP_LINE))
    room = ndimage.distance_transform_edt(np.pad(~closed, 1))[1:-1, 1:-1]
    ends = [(float(row), float(col)) for row, col in ground.in_window(np.array([start, goal]), window)]
    first, last = ((math.floor(row), math.floor(col)) for row, col in ends)
    reach = min(room[first], room[last], ground.site.vehicle.reach_m / pixel)
    levels = np.unique(room[(room >= _LEAST_OPENING) & (room < reach)])
    for level in levels[::-1].tolist():
        pieces = ndimage.label(room >= level)[0]
        if pieces[first] == pieces[last]:
            break
    else:
        return None
    cost = np.where(room < reach, np.float32(_TOO_NARROW), np.float32(1.0))
    cost[room < level] = np.inf
    found = find_way(cost, *ends, margin=PIXEL_MARGIN)
    if found is None:
        return None
    steps = [np.linspace(a, b, 2 + math.ceil(2.0 * math.dist(a, b))) for a, b in pairwise(found)]
    places = np.floor(np.concatenate(steps)).astype(np.int64)
    narrowest = places[room[places[:, 0], places[:, 1]].argmin()]
    width = (2.0 * room[tuple(narrowest)] - 1.0) * pixel
    return on_grid((narrowest[None] + 0.5) / pixels, ground.site.grid, window)[0], float(width)
