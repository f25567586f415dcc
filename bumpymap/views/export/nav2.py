"""Files for Nav2: a map with graded cost, a keepout mask, a speed mask, and the parameters that load them, as YAML.

What their readers do with them (map_server, costmaps and their filters, the Smac planner) is stated on the page about
robots, and held by the tests.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import FAIL_SHARE, BadInputError
from bumpymap.layers import MapReader, class_limits
from bumpymap.views.export.area import (
    FRAME,
    FREE_CELL,
    LETHAL,
    TOP_VALUE,
    UNKNOWN_CELL,
    ExportArea,
    by_pixel,
    cell_states,
    speed_values,
    write_file,
)
from bumpymap.views.page.page import render_text
from bumpymap.views.words import seen_sizes

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
_TINY = float(np.finfo(np.float64).tiny)
_SCALES = {
    "map": "0: cost 1 a metre, smooth and safe. {top}: {most:.3f} or more, very rough. {lethal}: lethal. 255: unknown.",
    "keepout_mask": "0: free. {lethal}: not passable, or unknown.",
    "speed_mask": "Percent of {speed:g} m/s.",
}
"""Comments on what the values of the images mean."""


def make_grids(area: ExportArea, max_cost: float | None) -> Callable[[Path], dict[str, Any]]:
    """Make the images of an area, and return what writes the files and says what the sidecar file says of them.

    ``max_cost``: cost per metre that gets the highest value; else that of very rough ground, so that values mean the
    same in every map for a vehicle: C_r at the limit of class 3, and the share of failing drives that bars ground.
    Raises BadInputError: there are too many cells, or none of them is free.
    """
    area.require_cells(_MAX_CELLS, "a map for Nav2")
    site, highest = area.route_map, 1.0
    very_rough = site.rule.cost(np.array(class_limits(site.manifest)[-1]), site.rule.hazard(np.array(FAIL_SHARE)))
    most = max_cost or float(very_rough)
    cost, keepout, speed = (np.empty(area.shape, np.uint8) for _ in range(3))
    for window, lines in area.strips(detail=site.grid.pixels):
        field = site.read(window, ("c_r", "p_fail", "obstacle"))
        states, _ = cell_states(area, field)
        of_tile = field.rule.cost(field.c_r.astype(np.float64), field.rule.hazard(field.p_fail))
        values = np.rint(TOP_VALUE * (np.nan_to_num(of_tile, nan=most).clip(1.0, most) - 1.0) / max(most - 1.0, _TINY))
        is_free = states == FREE_CELL
        cost[lines] = np.where(is_free, by_pixel(values.astype(np.uint8), area.split), states)
        keepout[lines] = np.where(is_free, np.uint8(FREE_CELL), np.uint8(LETHAL))
        speed[lines] = by_pixel(speed_values(field), area.split)
        used = is_free.reshape(window.rows, area.split, window.cols, area.split).any(axis=(1, 3))
        highest = max(highest, float(np.nanmax(of_tile[used], initial=1.0)))
    counts = {
        "free": int((keepout == FREE_CELL).sum()),
        "lethal": int((cost == LETHAL).sum()),
        "unknown": int((cost == UNKNOWN_CELL).sum()),
    }
    if not counts["free"]:
        raise BadInputError("no cell of the area is free, so no robot can drive there. Choose another area")
    images = {"map": cost, "keepout_mask": keepout, "speed_mask": speed}
    about = {
        "cost": {
            "value_0": 1.0,
            f"value_{TOP_VALUE}": most,
            "highest": highest,
            "unit": "cost per metre of level, smooth and safe ground",
        },
        "speed": {"value_100_m_per_s": site.rule.top_mps},
        "cells": counts,
    }

    def write(folder: Path) -> dict[str, Any]:
        for name, cells in images.items():
            header = f"P5\n{cells.shape[1]} {cells.shape[0]}\n255\n"
            write_file(folder / f"{name}.pgm", header.encode(), cells.tobytes())
            scale = _SCALES[name].format(most=most, top=TOP_VALUE, lethal=LETHAL, speed=site.rule.top_mps)
            scale = f"{scale} {seen_sizes(site.manifest).sentence}".rstrip()
            west, south = float(area.bounds.west), float(area.bounds.south)
            text = [  # the thresholds are required, though mode raw does not use them
                *(f"# {scale}", f"image: {name}.pgm", "mode: raw", f"resolution: {area.resolution!r}"),
                *(f"origin: [{west!r}, {south!r}, 0.0]", "negate: 0", "occupied_thresh: 0.65", "free_thresh: 0.25", ""),
            ]
            write_file(folder / f"{name}.yaml", "\n".join(text).encode())
        write_file(folder / "nav2_params.yaml", params_text(site, most, area.resolution).encode())
        return about

    return write
