"""What of a map is exported, the local frame of the robot that it is written in, and the folder, filled at once."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from os.path import lexists
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import BadInputError, OutputError, atomic, locked, remove_empty_on_error, write_together
from bumpymap.layers.manifest import MANIFEST_NAME
from bumpymap.layers.products import refuse_present
from bumpymap.layers.route_map import RouteMap
from bumpytiles import Bounds, TileWindow

__all__ = [
    "DATUM_NAME",
    "EXPORT_FILES",
    "FRAME",
    "ExportArea",
    "ExportPoint",
    "LocalFrame",
    "check_target",
    "choose_area",
    "export_folder",
    "write_file",
    "write_json",
]

FRAME = "map"
"""Name of the frame of all exports, as REP-105 calls the frame that is fixed to the world."""
_STRIP_CELLS = 4_000_000
"""Cells that are read at once: few strips, so that few blocks of a raster are decoded twice."""


@dataclass(frozen=True, slots=True)
class ExportPoint:
    """A place on the grid of a map."""

    easting: float
    """m."""
    northing: float
    """m."""


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """A plane frame in metres: x to the east and y to the north of the grid, (0, 0) at the datum (REP-103)."""

    datum: ExportPoint

    def to_local(self, easting: Any, northing: Any) -> tuple[Any, Any]:
        """Convert easting and northing on the grid to x and y, m; numbers or arrays."""
        return easting - self.datum.easting, northing - self.datum.northing


@dataclass(frozen=True, slots=True)
class ExportArea:
    """A window of a map, its cells and its frame."""

    route_map: RouteMap
    window: TileWindow
    frame: LocalFrame
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
        west, south = self.frame.to_local(whole.west, whole.south)
        east, north = self.frame.to_local(whole.east, whole.north)
        return Bounds(west, south, east, north)

    def strips(self, detail: int | None = None) -> Iterator[tuple[TileWindow, slice]]:
        """Yield windows of whole rows of tiles, north first, and their rows of cells.

        ``detail`` is the number of values along a side of a tile that will be read, if that is not ``split``.
        """
        window, split = self.window, self.split
        height = max(1, _STRIP_CELLS // (window.cols * (detail or split) ** 2))
        for top in range(0, window.rows, height):
            rows = min(height, window.rows - top)
            part = TileWindow(window.col, window.row + window.rows - top - rows, window.cols, rows)
            yield part, slice(top * split, (top + rows) * split)

    def describe(self) -> dict[str, Any]:
        """Return where the frame lies on Earth, for the sidecar file.

        ``grid_convergence_deg`` is the angle from true north to grid north, clockwise; ``grid_scale`` is a length on
        the grid over the same length on the ellipsoid.
        """
        datum, bounds = self.frame.datum, self.bounds
        x, y = self.route_map.to_crs(datum.easting, datum.northing)
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

        datum, crs = self.frame.datum, self.route_map.georeference.crs
        longitude, latitude = self.route_map.to_lonlat(datum.easting, datum.northing)
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


def choose_area(
    route_map: RouteMap, split: int, around: ExportPoint | None, radius_m: float, datum: ExportPoint | None
) -> ExportArea:
    """Choose the window to export, and its local frame.

    Parameters
    ----------
    route_map : RouteMap
    split : int
        Cells along a side of a tile.
    around : ExportPoint, optional
        Export the tiles of a square around this point, up to ``radius`` to each side; else the whole map.
    radius_m : float
    datum : ExportPoint, optional
        Origin of the frame; else the corner of a tile nearest to ``around``, or to the middle of the map. Then cells
        and origin are aligned, as costmaps that roll with the robot want it.

    Raises
    ------
    BadInputError
        The square does not touch the map.
    """
    window, size = route_map.window, route_map.grid.tile_size
    if around is not None:
        window = _crop(route_map, around, radius_m)
    if datum is None:
        middle = around or ExportPoint((window.col + window.cols / 2) * size, (window.row + window.rows / 2) * size)
        datum = ExportPoint(round(middle.easting / size) * size, round(middle.northing / size) * size)
    return ExportArea(route_map, window, LocalFrame(datum), split)


def _crop(route_map: RouteMap, around: ExportPoint, radius_m: float) -> TileWindow:
    whole, grid = route_map.window, route_map.grid
    sides = np.array([around.easting, around.northing])
    first = grid.index(sides - radius_m)
    last = grid.index(sides + radius_m)
    west, south = max(int(first[0]), whole.col), max(int(first[1]), whole.row)
    east, north = min(int(last[0]) + 1, whole.col + whole.cols), min(int(last[1]) + 1, whole.row + whole.rows)
    if east <= west or north <= south:
        bounds = grid.window_bounds(whole)
        (left, low), (right, top) = (
            route_map.to_crs(bounds.west, bounds.south),
            route_map.to_crs(bounds.east, bounds.north),
        )
        x, y = route_map.to_crs(around.easting, around.northing)
        raise BadInputError(
            f"nothing of the map lies within {radius_m:g} m of {x:.1f},{y:.1f}: it reaches from {left:.1f},{low:.1f} "
            f"to {right:.1f},{top:.1f}. Choose a point on the map, or a larger radius"
        )
    return TileWindow(west, south, east - west, north - south)


DATUM_NAME = "datum.json"
"""The sidecar file with the local datum. It is written last: a folder that has one holds a complete export."""
EXPORT_FILES: dict[str, tuple[str, ...]] = {
    "nav2": (
        "map.yaml",
        "map.pgm",
        "keepout_mask.yaml",
        "keepout_mask.pgm",
        "speed_mask.yaml",
        "speed_mask.pgm",
        "nav2_params.yaml",
        DATUM_NAME,
    ),
    "gridmap": ("gridmap.mcap", "metadata.yaml", DATUM_NAME),
    "graph": ("graph.geojson", DATUM_NAME),
    "plan": ("route.plan", DATUM_NAME),
    "cost": ("cost.tif", DATUM_NAME),
}
"""Files of an export, by format."""


def check_target(out: Path, to: str, *, overwrite: bool) -> None:
    """Check that an export can be written to a folder, without touching it.

    Raises
    ------
    OutputError
        It is a file, holds the layers of a run or an export in another format, or an earlier export and ``overwrite``
        is False.
    """
    if lexists(out) and not out.is_dir():
        raise OutputError(f"cannot write to the folder {out}: it is not a folder. Choose another `out`")
    if lexists(out / MANIFEST_NAME):
        raise OutputError(f"{out} holds the layers of a run; an export has a folder of its own. Choose another `out`")
    own = EXPORT_FILES[to]
    foreign = sorted(
        name for names in EXPORT_FILES.values() for name in names if name not in own and lexists(out / name)
    )
    if foreign:
        raise OutputError(f"{out} already holds {foreign[0]} of an export in another format. Choose another `out`")
    refuse_present(out, own, overwrite=overwrite)


@contextmanager
def export_folder(out: Path, to: str, *, overwrite: bool) -> Iterator[Path]:
    """Yield an empty folder to write an export to; at the end its files move to ``out``, or none.

    A file that is a symbolic link is replaced as a link; its target is not touched.

    Raises
    ------
    OutputError
        See `check_target`; or another process is writing there, or the files cannot be written.
    """
    with remove_empty_on_error(out), locked(out):
        check_target(out, to, overwrite=overwrite)
        with write_together(out, DATUM_NAME) as staged:
            yield staged


def write_file(path: Path, *parts: bytes) -> None:
    """Write a file of given bytes. Raises OutputError if that fails."""
    with atomic(path) as temporary, temporary.open("wb") as file:
        for part in parts:
            file.write(part)


def write_json(path: Path, record: Mapping[str, Any]) -> None:
    """Write a record as JSON with one entry a line. Raises OutputError if that fails."""
    text = json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_file(path, text.encode("utf-8", "backslashreplace"))
