"""Drive the simulated vehicle along known lines of a map; hold the ride of the line, and of its tiles, against it.

    python tests/benchmarks/line_drives.py LAYERS DRIVES.jsonl --lines 160 [--seed 5] [--sample] [--engine second]
    python tests/benchmarks/line_drives.py LAYERS DRIVES.jsonl --report

Lines of 10 m begin anywhere at any heading, on ground that is passable all along. The ground is that of the heightmap,
without what stands on it, or with --sample the surface in closed form that the sample survey was made from. The same
seed takes the same lines in either engine; the second is MuJoCo, see second_engine.py.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.stats import spearmanr

import bumpymap
from bumpymap.core import CANOPY, OBSTACLE, axis_values
from bumpymap.lab.settings import DriveSettings
from bumpymap.lab.simulate.drive import Start, drive_from, drive_strip, follow
from bumpymap.layers import open_map
from bumpymap.rating import Vehicle, find_calibration

BEFORE_M, MEASURED_M = 1.0, 10.0
"""Way until a drive is measured, and the measured way, at 1 m/s."""


class Ground:
    """The ground about a place: coordinates near 0, as meshes are of single precision; pixel centres are vertices."""

    extent, spacing, gradient = 1e9, 0.1, (0.0, 0.0)

    def __init__(self, surface, place):
        self._surface, self._place = surface, np.floor(np.array(place) / self.spacing) * self.spacing
        self.start = np.array(place) - self._place

    def height(self, east, north):
        """Return heights of points, m."""
        return self._surface(np.asarray(east) + self._place[0], np.asarray(north) + self._place[1])


def surface_of(site, of_sample):
    """Return the surface of a map, or that of the sample survey, as a function of easting and northing."""
    if of_sample:
        sys.path.insert(0, str(Path(__file__).parents[1] / "worlds"))
        from made_quarry import height

        return lambda east, north: np.asarray(height(*np.broadcast_arrays(east, north)))
    window, pixel = site.window, site.grid.pixel_size
    heights = np.where(np.isin(site.objects(window), (OBSTACLE, CANOPY)), np.nan, site.heights(window).astype(float))
    nearest = distance_transform_edt(np.isnan(heights), return_distances=False, return_indices=True)
    heights, top = heights[tuple(nearest)], (window.row + window.rows) * site.grid.tile_size

    def surface(east, north):
        place = [(top - north) / pixel - 0.5, (east - window.col * site.grid.tile_size) / pixel - 0.5]
        return map_coordinates(heights, place, order=1, mode="nearest")

    return surface


def tiles_at(site, row, distance):
    """Return row and column in the map's window of the tiles at distances along a line, and the pixels likewise."""
    easting, northing = (
        row["east"] + distance * np.cos(row["heading"]),
        row["north"] + distance * np.sin(row["heading"]),
    )
    window, grid = site.window, site.grid
    place = np.array([window.row + window.rows - northing / grid.tile_size, easting / grid.tile_size - window.col])
    return np.floor(place).astype(int), np.floor(place * grid.pixels).astype(int)


def drive_line(vehicle, ground, heading, engine):
    """Drive along one line from the ground's start."""
    start, settings = Start(*ground.start, heading), DriveSettings()
    if engine == "first":
        return drive_from(vehicle, ground, start, settings)
    from second_engine import TORQUE, SecondVehicle

    strip = drive_strip(vehicle, start, settings)
    return follow(SecondVehicle(vehicle, ground, strip, TORQUE), strip, vehicle, settings)


def drive_all(given, site):
    """Drive along lines until there are as many as asked for."""
    vehicle = Vehicle.from_dict(find_calibration(site.vehicle.name).vehicle, site.vehicle.name)
    surface, window = surface_of(site, given.sample), site.window
    is_open, passage = site.values(window, ("c_r",))["barred"] == 0, site.passage(window)
    rng, done = np.random.default_rng(given.seed), 0
    while done < given.lines:
        east, north, turn = rng.random(3)
        row = {
            "east": (window.col + east * window.cols) * site.grid.tile_size,
            "north": (window.row + north * window.rows) * site.grid.tile_size,
            "heading": 2 * np.pi * turn,
        }
        tiles, pixels = tiles_at(site, row, np.linspace(-1.5, MEASURED_M + 3.5, 60))
        if (tiles < 0).any() or (tiles >= [[window.rows], [window.cols]]).any():
            continue
        if not (is_open[tuple(tiles)].all() and passage[tuple(pixels)].all()):
            continue
        found = drive_line(vehicle, Ground(surface, (row["east"], row["north"])), row["heading"], given.engine)
        with given.drives.open("a") as file:
            file.write(json.dumps(row | {"c_r": found.c_r, "outcome": found.outcome}) + "\n")
        done += 1


def report(given, site):
    """Print how well the tiles and the line itself predict the drives."""
    rows = [row for row in map(json.loads, given.drives.open()) if row["outcome"] == "completed"]
    c_r, found = site.values(site.window, ("c_r",))["c_r"], []
    headings = site.headings(site.window) if site.has_headings else np.repeat(c_r[..., None], 8, axis=2)
    for row in rows:
        ahead = np.array([np.cos(row["heading"]), np.sin(row["heading"])])
        line = np.array([row["east"], row["north"]]) + np.outer((0.0, BEFORE_M + MEASURED_M + 0.5), ahead)
        ride = bumpymap.ride_along(given.layers, np.column_stack(site.to_crs(*line.T)), sigma=0.05)
        tiles, _ = tiles_at(site, row, np.linspace(BEFORE_M, BEFORE_M + MEASURED_M, 200))
        by_heading = axis_values(headings[tuple(tiles)], -ahead[1], ahead[0])
        of_tiles = np.nanmean(c_r[tuple(tiles)]), np.nanmean(by_heading)
        found.append((row["c_r"], *of_tiles, *ride.over(BEFORE_M, BEFORE_M + MEASURED_M)))
    driven, of_tiles, by_heading, of_line, low, high = np.array(found).T
    third = np.searchsorted(np.quantile(driven, [1 / 3, 2 / 3]), driven)
    print(
        "| predicted by | drives | Spearman | median error | by third | median predicted / driven |",
        "|---|---|---|---|---|---|",
        sep="\n",
    )
    for name, predicted in (("tiles", of_tiles), ("tiles by heading", by_heading), ("line", of_line)):
        error = np.abs(np.log(predicted / driven))
        thirds = " / ".join(f"{100 * np.median(error[third == k]):.0f}" for k in range(3))
        rank, middle = f"{spearmanr(predicted, driven).statistic:.3f}", f"{100 * np.median(error):.1f} %"
        print(f"| {name} | {len(driven)} | {rank} | {middle} | {thirds} % | {np.median(predicted / driven):.2f} |")
    inside = (driven >= low) & (driven <= high)
    print(
        f"\nIn the line's 80 % interval: {inside.mean():.2f}, by third",
        *(f"{inside[third == k].mean():.2f}" for k in range(3)),
    )


def main():
    """Drive, or report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("layers", type=Path)
    parser.add_argument("drives", type=Path)
    parser.add_argument("--lines", type=int, default=160)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--sample", action="store_true")
    parser.add_argument("--engine", choices=("first", "second"), default="first")
    parser.add_argument("--report", action="store_true")
    given = parser.parse_args()
    (report if given.report else drive_all)(given, open_map(given.layers))


if __name__ == "__main__":
    main()
