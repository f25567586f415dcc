"""The exported part of a map in the local frame of the robot, its costs, and the files for Nav2.

Costs of cells go pixel by pixel with obstacles grown; for occupancy grids, unknown is not free. For Nav2 these are a
map with graded cost, a keepout mask, a speed mask, and the parameters that load them, as YAML. What their readers do
with them (map_server, costmaps and their filters, the Smac planner) is stated on the page about robots, and held by the
tests.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from bumpymap.core import (
    CANOPY,
    CLOSED_IN_PART,
    CROSSING_UNKNOWN,
    FAIL_SHARE,
    NO_TILE,
    OBSTACLE,
    OPEN_THROUGH,
    BadInputError,
    Band,
    Barred,
    TileField,
)
from bumpymap.layers import (
    STEP_LINE,
    UNKNOWN_OBJECT,
    MapReader,
    Placement,
    RasterSpec,
    RasterWindow,
    class_limits,
    common_window,
    write_cog,
)
from bumpymap.views.page.page import render_text
from bumpymap.views.words import seen_sizes
from bumpytiles import Bounds, TileWindow

_Value = TypeVar("_Value", bound=np.generic)
FREE_CELL, LETHAL, UNKNOWN_CELL = 0, 100, 255
"""Cells of an occupancy grid in mode ``raw``; map_server reads all values over 100 as unknown (-1)."""
TOP_VALUE = 98
"""Value of the costliest ground. Not 99: newer costmaps read that as the inscribed radius of an obstacle."""
SLOWEST = 1
"""Least speed limit, percent. Not 0: the speed filter reads that as no limit."""


def by_pixel(values: NDArray[_Value], pixels: int) -> NDArray[_Value]:
    """Give every pixel the value of its tile: (rows, cols) -> (rows * pixels, cols * pixels)."""
    return np.asarray(np.repeat(np.repeat(values, pixels, axis=0), pixels, axis=1))


def cell_states(area: "ExportArea", field: TileField) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return what a robot may do in the cells of some tiles of an area, north row first.

    It is decided on pixels, and a larger cell is as the worst of its pixels: a planner goes anywhere in a free cell.
    Returns ``states`` uint8 (rows * split, cols * split): ``LETHAL`` where an obstacle stands or a step is, in unknown
    tiles too, and where the ground bars the tile; ``UNKNOWN_CELL`` in unknown tiles, outside of the tiles, and where
    objects were distinguished from ground and neither was seen; else ``FREE_CELL``. Where only obstacles or steps close
    a tile, it is free where the vehicle passes between them. ``canopy``: True where a free cell is in part under canopy
    that the vehicle fits under.
    """
    pixels, barred = area.route_map.grid.pixels, field.barred
    objects = area.route_map.objects(field.window)
    closed = np.where(np.isin(barred, (*CROSSING_UNKNOWN, NO_TILE)), np.uint8(UNKNOWN_CELL), np.uint8(LETHAL))
    states = by_pixel(np.where(barred == Barred.NO, np.uint8(FREE_CELL), closed), pixels)
    # Where objects were not distinguished they are part of the relief, and in the ride cost.
    judged = by_pixel(~np.isnan(field.obstacle), pixels)
    states[(objects == UNKNOWN_OBJECT) & judged & (states == FREE_CELL)] = UNKNOWN_CELL
    states[_open_in_part(area.route_map, field)] = FREE_CELL
    states[(objects == OBSTACLE) | (objects == STEP_LINE)] = LETHAL
    canopy = objects == CANOPY
    if area.split < pixels:
        cells = (field.window.rows * area.split, pixels // area.split, field.window.cols * area.split, -1)
        found = (states == LETHAL, states == UNKNOWN_CELL, canopy)
        lethal, unseen, canopy = (each.reshape(cells).any(axis=(1, 3)) for each in found)
        states = np.select([lethal, unseen], [np.uint8(LETHAL), np.uint8(UNKNOWN_CELL)], np.uint8(FREE_CELL))
    return states, canopy & (states == FREE_CELL)


def _open_in_part(route_map: MapReader, field: TileField) -> NDArray[np.bool_]:
    """Return the pixels of tiles that obstacles or steps alone close over which the vehicle passes between these.

    Of a tile of which the ground beside a step fails too, there are none.

    They lie nearer than half its width to where its middle can be, so they hold no obstacle and nothing unseen.
    """
    grid, window = route_map.grid, field.window
    pixels, reach = grid.pixels, 0.5 * route_map.vehicle.width_m / grid.pixel_size
    closed = np.isin(field.barred, CLOSED_IN_PART) & np.isfinite(field.c_r) & ~(field.p_fail >= FAIL_SHARE)
    ring = math.ceil(reach / pixels)
    free = route_map.passage(window.grown(ring)) if closed.any() else np.zeros((0, 0), np.bool_)
    if not free.any():
        return np.zeros((window.rows * pixels, window.cols * pixels), np.bool_)
    inner = slice(ring * pixels, -ring * pixels)
    swept = distance_transform_edt(~free)[inner, inner] < reach
    return np.asarray(swept & by_pixel(closed, pixels))


_BLOCK, _WINDOW_TILES = 512, 64
"""Of cost.tif: side of its blocks, pixels, as of heightmap.tif, and of the windows that are made at once, tiles."""


@dataclass(frozen=True, slots=True)
class ExportArea:
    """A window of a map, its cells and its frame: x to the east and y to the north of the grid, m (REP-103)."""

    route_map: MapReader
    window: TileWindow
    datum: tuple[float, float]
    """Origin of the frame: easting and northing, m."""
    split: int
    """Cells along a side of a tile: 1, or the pixels of the heightmap."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        return self.window.rows * self.split, self.window.cols * self.split

    @property
    def resolution(self) -> float:
        """Side of a cell, m."""
        return self.route_map.grid.tile_size / self.split

    @property
    def bounds(self) -> Bounds:
        """Sides of the area in the local frame, m."""
        whole = self.route_map.grid.window_bounds(self.window)
        x, y = self.datum
        return Bounds(whole.west - x, whole.south - y, whole.east - x, whole.north - y)

    def strips(self) -> Iterator[tuple[TileWindow, slice]]:
        """Yield windows of whole rows of tiles, north first, and their rows of cells."""
        window, split = self.window, self.split
        height = max(1, _STRIP_PIXELS // (window.cols * self.route_map.grid.pixels**2))
        for top, part in window.cut(height):
            yield part, slice(top * split, (top + part.rows) * split)

    def require_cells(self, most: int, kind: str) -> None:
        """Raise BadInputError if it has more cells than a kind of map may have."""
        rows, cols = self.shape
        if rows * cols > most:
            within = math.floor(0.5 * math.sqrt(most) * self.resolution - self.route_map.grid.tile_size)
            remedy = f"Crop it with `around` and `radius={max(within, 1)}` or less"
            if self.split > 1:
                remedy += ", or pass `resolution='tile'`: then a cell with an obstacle in it is closed as a whole"
            raise BadInputError(
                f"the area has {rows * cols:,} cells of {self.resolution:g} m; {kind} may have {most:,}. {remedy}"
            )

    def describe(self) -> dict[str, Any]:
        """Return where the frame lies on Earth, for the sidecar file.

        ``grid_convergence_deg`` is the angle from true north to grid north, clockwise; ``grid_scale`` is a length on
        the grid over the same length on the ellipsoid.
        """
        bounds = self.bounds
        x, y = self.route_map.to_crs(*self.datum)
        place: dict[str, Any] = {"longitude": None, "latitude": None, "x": x, "y": y, "crs": None}
        if self.route_map.has_crs:
            place |= self._on_earth()
        return {
            "frame": FRAME,
            "axes": "x to the east and y to the north of the grid, m",
            "datum": place,
            "metres_per_unit": self.route_map.georeference.metres_per_unit,
            "area": {"west": bounds.west, "south": bounds.south, "east": bounds.east, "north": bounds.north},
            "resolution_m": self.resolution,
        }

    def _on_earth(self) -> dict[str, Any]:
        from pyproj import Proj

        crs = self.route_map.georeference.crs
        longitude, latitude = self.route_map.to_lonlat(*self.datum)
        if crs is None or not np.isfinite([longitude, latitude]).all():
            raise BadInputError(
                "the datum cannot be converted to longitude and latitude: it lies outside the area of the map's CRS. "
                "Choose a datum near the map"
            )
        crs = crs.to_2d()
        factors = Proj(crs).get_factors(longitude, latitude)
        authority = crs.to_authority()
        return {
            "longitude": round(longitude, 9),
            "latitude": round(latitude, 9),
            "crs": {"name": crs.name, "code": ":".join(authority) if authority else None},
            "grid_convergence_deg": round(factors.meridian_convergence, 9),
            "grid_scale": round(factors.meridional_scale, 9),
        }


def write_pixel_cost(folder: Path, area: ExportArea) -> dict[str, Any]:
    """Write cost.tif: a float32 COG, the cost of a metre on each pixel, NaN where the middle of the vehicle cannot be.

    Raises BadInputError: the vehicle fits nowhere in the area.
    """
    site = area.route_map
    pixels, free = site.grid.pixels, 0

    def paint(window: RasterWindow) -> NDArray[np.float32]:
        nonlocal free
        field = site.read(window.tiles, ("c_r", "p_fail"))
        cost = field.rule.cost(field.c_r.astype(np.float64), field.rule.hazard(field.p_fail)).astype(np.float32)
        cost[~np.isin(field.barred, OPEN_THROUGH)] = np.nan
        out = by_pixel(cost, pixels)
        out[~site.passage(window.tiles) | ~np.isfinite(out)] = np.nan
        free += int(np.isfinite(out).sum())
        return out[None]

    place = Placement(site.georeference, site.grid, area.window)
    spec = RasterSpec(
        bands=[Band("cost", "", "factor on distance where the middle of the vehicle can be")],
        pixels=pixels,
        crs=place.horizontal_crs,
        block=_BLOCK,
        tags={"title": "cost of driving over each pixel", "vehicle": site.vehicle.name},
        level=1,
    )
    write_cog(folder / "cost.tif", place, spec, paint, _WINDOW_TILES)
    if not free:
        raise BadInputError("the vehicle fits nowhere in the area, so no robot can drive there. Choose another area")
    return {"pixels": free, "pixel_m": site.grid.pixel_size}


FRAME = "map"
"""Name of the frame of all exports, as REP-105 calls the frame that is fixed to the world."""
_STRIP_PIXELS = 4_000_000
"""Pixels that are read at once: few strips, so that few blocks of a raster are decoded twice."""


def choose_area(
    route_map: MapReader,
    split: int,
    around: tuple[float, float] | None,
    radius_m: float,
    datum: tuple[float, float] | None,
) -> ExportArea:
    """Choose the window to export, and its local frame.

    ``split``: cells along a side of a tile; ``around``: easting and northing, m: export the tiles of a square around
    this point, up to ``radius`` to each side; else the whole map; ``datum``: easting and northing of the frame's
    origin, m; else the corner of a tile nearest to ``around``, or to the middle of the map. Then cells and origin are
    aligned, as costmaps that roll with the robot want it. Raises BadInputError: the square does not touch the map.
    """
    window, size = route_map.window, route_map.grid.tile_size
    if around is not None:
        window = _crop(route_map, around, radius_m)
    if datum is None:
        east, north = around or ((window.col + window.cols / 2) * size, (window.row + window.rows / 2) * size)
        datum = round(east / size) * size, round(north / size) * size
    return ExportArea(route_map, window, datum, split)


def _crop(route_map: MapReader, around: tuple[float, float], radius_m: float) -> TileWindow:
    whole, grid = route_map.window, route_map.grid
    square = TileWindow.around(*(grid.index(np.array([middle - radius_m, middle + radius_m])) for middle in around))
    if (window := common_window(square, whole)) is None:
        bounds = grid.window_bounds(whole)
        corners = (bounds.west, bounds.south), (bounds.east, bounds.north), around
        low, high, point = ("{:.1f},{:.1f}".format(*route_map.to_crs(*corner)) for corner in corners)
        raise BadInputError(
            f"nothing of the map lies within {radius_m:g} m of {point}: it reaches from {low} to {high}. Choose a "
            "point on the map, or a larger radius"
        )
    return window


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


def write_nav2(folder: Path, area: ExportArea, max_cost: float | None) -> dict[str, Any]:
    """Write images and parameters to a folder, and return what the sidecar file says of them.

    ``max_cost``: cost per metre that gets the highest value; else that of very rough ground, so that values mean the
    same in every map for a vehicle: C_r at the limit of class 3, and the share of failing drives that bars ground.
    Raises BadInputError: there are too many cells, or none of them is free.
    """
    area.require_cells(_MAX_CELLS, "a map for Nav2")
    site = area.route_map
    very_rough = site.rule.cost(np.array(class_limits(site.manifest)[-1]), site.rule.hazard(np.array(FAIL_SHARE)))
    most = max_cost or float(very_rough)
    images, highest = _images(area, most)
    codes = {"free": images["keepout_mask"] == FREE_CELL}
    codes |= {"lethal": images["map"] == LETHAL, "unknown": images["map"] == UNKNOWN_CELL}
    counts = {name: int(found.sum()) for name, found in codes.items()}
    if not counts["free"]:
        raise BadInputError("no cell of the area is free, so no robot can drive there. Choose another area")
    west, south = float(area.bounds.west), float(area.bounds.south)
    for name, cells in images.items():
        with (folder / f"{name}.pgm").open("wb") as file:
            file.write(f"P5\n{cells.shape[1]} {cells.shape[0]}\n255\n".encode())
            file.write(cells.data)
        scale = _SCALES[name].format(most=most, top=TOP_VALUE, lethal=LETHAL, speed=site.rule.top_mps)
        scale = f"{scale} {seen_sizes(site.manifest).sentence}".rstrip()
        text = [  # the thresholds are required, though mode raw does not use them
            *(f"# {scale}", f"image: {name}.pgm", "mode: raw", f"resolution: {area.resolution!r}"),
            *(f"origin: [{west!r}, {south!r}, 0.0]", "negate: 0", "occupied_thresh: 0.65", "free_thresh: 0.25", ""),
        ]
        (folder / f"{name}.yaml").write_text("\n".join(text), encoding="utf-8")
    (folder / "nav2_params.yaml").write_text(params_text(site, most, area.resolution), encoding="utf-8")
    unit = "cost per metre of level, smooth and safe ground"
    return {
        "cost": {"value_0": 1.0, f"value_{TOP_VALUE}": most, "highest": highest, "unit": unit},
        "speed": {"value_100_m_per_s": site.rule.top_mps},
        "cells": counts,
    }


def _images(area: ExportArea, most: float) -> tuple[dict[str, NDArray[np.uint8]], float]:
    """Return the images of an area by name, and its highest cost; ``most``: cost of the highest value."""
    site, highest = area.route_map, 1.0
    cost, keepout, speed = (np.empty(area.shape, np.uint8) for _ in range(3))
    for window, lines in area.strips():
        field = site.read(window, ("c_r", "p_fail", "obstacle"))
        states, _ = cell_states(area, field)
        of_tile = field.rule.cost(field.c_r.astype(np.float64), field.rule.hazard(field.p_fail))
        values = np.rint(TOP_VALUE * (np.nan_to_num(of_tile, nan=most).clip(1.0, most) - 1.0) / max(most - 1.0, _TINY))
        is_free = states == FREE_CELL
        cost[lines] = np.where(is_free, by_pixel(values.astype(np.uint8), area.split), states)
        keepout[lines] = np.where(is_free, np.uint8(FREE_CELL), np.uint8(LETHAL))
        # In percent of the top speed, rounded down; the least where c_r is unknown, and where even that is too fast.
        percent = np.floor(100.0 / (field.rule.top_mps * field.rule.slowness(field.c_r)) + 1e-9)
        percent = np.clip(np.nan_to_num(percent, nan=SLOWEST), SLOWEST, 100)
        speed[lines] = by_pixel(percent.astype(np.uint8), area.split)
        used = is_free.reshape(window.rows, area.split, window.cols, area.split).any(axis=(1, 3))
        highest = max(highest, float(np.nanmax(of_tile[used], initial=1.0)))
    return {"map": cost, "keepout_mask": keepout, "speed_mask": speed}, highest
