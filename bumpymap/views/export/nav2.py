"""Files for Nav2: a map with graded cost, a keepout mask, a speed mask, and the parameters that load them, as YAML.

What their readers do with them (map_server, costmaps and their filters, the Smac planner) is stated on the page about
robots, and held by the tests.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import CROSSING_UNKNOWN, NO_TILE, BadInputError, Barred
from bumpymap.layers import MapReader
from bumpymap.views.export.area import (
    CLOSED_IN_PART,
    FRAME,
    LETHAL,
    TOP_VALUE,
    UNKNOWN_CELL,
    ExportArea,
    by_pixel,
    cost_values,
    keepout_values,
    lay_objects,
    open_in_part,
    passable_cost,
    speed_values,
    write_file,
)
from bumpymap.views.page.page import render_text

_COSTMAP_LETHAL, _SMAC_FULL = 254, 252
"""Cost of a lethal cell of a costmap; the cost by which Smac planners divide."""


def params_text(route_map: MapReader, max_cost: float, resolution: float) -> str:
    """Return the parameters as YAML.

    With its ``cost_travel_multiplier`` the Smac 2D planner counts cost per metre as the map does. The costmap scales
    0..100 to 0..254 and drops decimals; the planner's cost of a step is ``length * (1 + multiplier * cell / 252)``.
    """
    multiplier = (max_cost - 1.0) * _SMAC_FULL / math.floor(TOP_VALUE / LETHAL * _COSTMAP_LETHAL)
    about = {
        "frame": FRAME,
        "speed": route_map.rule.top_mps,
        "resolution": resolution,
        "radius": round(route_map.vehicle.width_m / 2.0, 3),
        "lethal": LETHAL,
        "cost": round(max_cost, 6),
        "top": TOP_VALUE,
        "multiplier": round(multiplier, 6),
    }
    return render_text("nav2_params.yaml", **about) + "\n"


_MAX_CELLS = 100_000_000
"""Most cells of an occupancy grid: every node of Nav2 that uses it keeps a copy."""
_BANDS = ("c_r", "p_fail")


def make_grids(area: ExportArea, max_cost: float | None) -> Callable[[Path], dict[str, Any]]:
    """Make the images of an area, and return what writes the files and says what the sidecar file says of them.

    Parameters
    ----------
    area : ExportArea
    max_cost : float, optional
        Cost per metre that gets the highest value; else that of the costliest passable tile of the area.

    Raises
    ------
    BadInputError
        There are too many cells, or no tile of the area is passable.
    """
    area.require_cells(_MAX_CELLS, "a map for Nav2")
    highest, tiles = _survey(area)
    if not tiles["passable"]:
        raise BadInputError("no tile of the area is passable, so no robot can drive there. Choose another area")
    most = max_cost or highest
    cost, keepout, speed = (np.empty(area.shape, np.uint8) for _ in range(3))
    for window, lines in area.strips():
        field = area.route_map.read(window, (*_BANDS, *(["obstacle"] if area.split > 1 else [])))
        coarse = cost_values(field, most), keepout_values(field), speed_values(field)
        if area.split == 1:
            cost[lines], keepout[lines], speed[lines] = coarse
            continue
        objects = area.route_map.objects(window)
        judged = ~np.isnan(field.obstacle)
        between = open_in_part(area.route_map, field)
        barred = np.where(np.isin(field.barred, CLOSED_IN_PART), np.uint8(Barred.NO), field.barred)
        opened = replace(field, barred=barred)
        cost[lines] = lay_objects(coarse[0], objects, judged, UNKNOWN_CELL)
        keepout[lines] = lay_objects(coarse[1], objects, judged, LETHAL)
        for cells, values in ((cost, cost_values(opened, most)), (keepout, keepout_values(opened))):
            cells[lines][between] = by_pixel(values, area.split)[between]
        speed[lines] = by_pixel(coarse[2], area.split)
    images = {"map": cost, "keepout_mask": keepout, "speed_mask": speed}
    about = {
        "cost": {
            "value_0": 1.0,
            f"value_{TOP_VALUE}": most,
            "unit": "cost per metre of level, smooth and safe ground",
        },
        "speed": {"value_100_m_per_s": area.route_map.rule.top_mps},
        "tiles": tiles,
    }

    def write(folder: Path) -> dict[str, Any]:
        for name, cells in images.items():
            header = f"P5\n{cells.shape[1]} {cells.shape[0]}\n255\n"
            write_file(folder / f"{name}.pgm", header.encode(), cells.tobytes())
            write_file(folder / f"{name}.yaml", "".join(_map_yaml(f"{name}.pgm", area)).encode())
        write_file(folder / "nav2_params.yaml", params_text(area.route_map, most, area.resolution).encode())
        return about

    return write


def _survey(area: ExportArea) -> tuple[float, dict[str, int]]:
    """Return the highest cost of a passable tile, and the numbers of tiles by state."""
    highest, counts = 1.0, np.zeros(3, np.int64)
    for window, _ in area.strips():
        field = area.route_map.read(window, _BANDS)
        cost = passable_cost(field)
        highest = float(np.fmax(highest, np.nanmax(cost, initial=1.0)))
        passable, unknown = np.count_nonzero(~np.isnan(cost)), np.count_nonzero(np.isin(field.barred, CROSSING_UNKNOWN))
        there = np.count_nonzero(field.barred != NO_TILE)
        counts += passable, there - passable - unknown, unknown
    return highest, dict(zip(("passable", "barred", "unknown"), map(int, counts), strict=True))


def _map_yaml(image: str, area: ExportArea) -> Iterator[str]:
    """Yield the lines of a map's metadata; the thresholds are required, though mode ``raw`` does not use them."""
    bounds = area.bounds
    yield f"image: {image}\n"
    yield "mode: raw\n"
    yield f"resolution: {area.resolution!r}\n"
    yield f"origin: [{float(bounds.west)!r}, {float(bounds.south)!r}, 0.0]\n"
    yield "negate: 0\n"
    yield "occupied_thresh: 0.65\n"
    yield "free_thresh: 0.25\n"
