"""Plan ways between random places of a map, and hold each against a plain search over its pixels with scipy.

    python tests/benchmarks/way_pairs.py LAYERS [--pairs 40] [--seed 1] [--joined]

Starts and goals are drawn from all pixels on which the middle of the vehicle can be, at least 20 m apart. A way touches
if it comes nearer to an obstacle pixel than half the vehicle's width, between it and the pixel's middle; obstacles are
those of obstacle.tif, and the distances scipy's. The search steps over the pixels of passage.tif in eight directions,
and in sixteen, at the cost of their tiles; over a corner between closed pixels where the vehicle may do so.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import rasterio
from scipy.ndimage import generate_binary_structure, label
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

import bumpymap
from bumpymap.core import corners_join

LEAST_M = 20.0
OBSTACLE = 1
EIGHT = ((0, 1), (1, 0), (1, 1), (1, -1))
SIXTEEN = (*EIGHT, (1, 2), (2, 1), (2, -1), (1, -2))


def passed_pixels(down, right, corners):
    """Return the pixels of a move, (down, right, share of its length); past a corner, those beside it have none.

    With ``corners``, they may be closed.
    """
    ends = [(0, 0, 0.5), (down, right, 0.5)]
    if abs(down * right) == 1 and not corners:
        return [*ends, (down, 0, 0.0), (0, right, 0.0)]
    if abs(down * right) == 2:
        between = [(1, 0), (1, right)] if down == 2 else [(0, right // 2), (1, right // 2)]
        return [(row, col, 0.25) for row, col in [(0, 0), (down, right), *between]]
    return ends


class PixelSearch:
    """Shortest paths over pixels, (rows, cols) costs of a metre, NaN where closed."""

    def __init__(self, cost, pixel, moves, corners):
        self.corners = corners
        self.number = np.full(cost.shape, -1)
        free = np.isfinite(cost)
        self.number[free] = np.arange(free.sum())
        parts = [self._move(cost, pixel, *move) for move in moves]
        first, last, weight = (np.concatenate(each) for each in zip(*parts, strict=True))
        self.graph = csr_array((weight, (first, last)), (int(free.sum()),) * 2)

    def _move(self, cost, pixel, down, right):
        """Return the moves of one kind from pixel to pixel, and their costs, m."""
        rows, cols = cost.shape
        west, east = max(0, -right), cols - max(0, right)
        total = 0.0
        for row, col, share in passed_pixels(down, right, self.corners):
            total = total + share * cost[row : rows - down + row, west + col : east + col]
        kept = np.isfinite(total)  # no share of a closed pixel is a number
        here, there = self.number[: rows - down, west:east], self.number[down:, west + right : east + right]
        return here[kept], there[kept], np.hypot(down, right) * pixel * total[kept]

    def between(self, start, goal):
        """Return the cost between two pixels, m; inf if there is no path."""
        found = dijkstra(self.graph, directed=False, indices=self.number[start])
        return float(found[self.number[goal]])


def read_map(folder):
    """Return cost by pixel, NaN where the vehicle does not fit; places of obstacles, m; transform; width, m."""
    manifest = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    rule = manifest["cost"]
    with rasterio.open(folder / "passage.tif") as file:
        areas, transform = file.read(1), file.transform
        free = (areas > 0) & (areas < 255)
    with rasterio.open(folder / "roughness.tif") as file:
        bands = dict(zip(file.descriptions, range(1, file.count + 1), strict=True))
        c_r, p_fail = (file.read(bands[name]).astype(np.float64) for name in ("c_r", "p_fail"))
    hazard = -np.log1p(-p_fail) / rule["drive_m"]
    cost = 1.0 + rule["ride_weight_m_per_rad"] * c_r + rule["fail_weight_m"] * np.nan_to_num(hazard)
    pixels = areas.shape[0] // cost.shape[0]
    cost = np.where(free, np.repeat(np.repeat(cost, pixels, 0), pixels, 1), np.nan)
    with rasterio.open(folder / "obstacle.tif") as file:
        rows, cols = np.nonzero(file.read(1) == OBSTACLE)
    places = np.column_stack(transform * (cols + 0.5, rows + 0.5))
    return cost, places, transform, manifest["vehicle"]["width_m"]


def points_along(line, step=0.02):
    """Return points on a line, (n, 2) m."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    at = np.append(np.arange(0.0, along[-1], step), along[-1])
    return np.column_stack([np.interp(at, along, line[:, axis]) for axis in (0, 1)])


def main():
    """Plan, compare, print a line for each pair and the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("layers", type=Path)
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--joined", action="store_true", help="draw only pairs with a way between them over pixels")
    given = parser.parse_args()
    cost, obstacles, transform, width = read_map(given.layers)
    tree, pixel, rng = cKDTree(obstacles), abs(transform.a), np.random.default_rng(given.seed)
    places = np.argwhere(np.isfinite(cost))
    corners = corners_join(width, 0.5 * width + 0.1, pixel)
    pieces = label(np.isfinite(cost), generate_binary_structure(2, 1 + corners))[0]
    plain = [PixelSearch(cost, pixel, moves, corners) for moves in (EIGHT, SIXTEEN)]
    touched, missing, extra, ratios, seconds, room = 0, 0, 0, [], 0.0, []
    for number in range(given.pairs):
        while True:
            start, goal = (tuple(map(int, place)) for place in places[rng.integers(len(places), size=2)])
            is_joined = pieces[start] == pieces[goal]
            is_far = np.hypot(*np.subtract(start, goal)) * pixel >= LEAST_M
            if is_far and (is_joined or not given.joined):
                break
        ends = [transform * (col + 0.5, row + 0.5) for row, col in (start, goal)]
        begin = time.process_time()
        try:
            (route,) = bumpymap.find_routes(given.layers, *(f"crs:{x!r},{y!r}" for x, y in ends))
        except bumpymap.BadInputError as error:
            seconds += time.process_time() - begin
            missing += is_joined
            if is_joined:
                print(number, "MISSING", ends, str(error)[:300], flush=True)
            continue
        seconds += time.process_time() - begin
        if not is_joined:
            extra += 1
            print(number, "EXTRA", ends, flush=True)
            continue
        gap = tree.query(points_along(np.asarray(route.line)))[0].min()
        best = [search.between(start, goal) for search in plain]
        ratios.append([route.figures.cost_m / each for each in best])
        room.append(gap)
        touched += gap < 0.5 * width
        print(
            f"{number}: {route.figures.length_m:.0f} m, cost {route.figures.cost_m:.1f}, of 8 directions "
            f"{ratios[-1][0]:.3f}, of 16 {ratios[-1][1]:.3f}, nearest obstacle {gap:.2f} m"
            f"{' TOUCHES' if gap < 0.5 * width else ''}",
            flush=True,
        )
    ratios = np.array(ratios).reshape(-1, 2)
    print(f"{given.layers.name}: {given.pairs} pairs, {len(ratios)} with a way over pixels; {touched} touch", end="; ")
    print(f"{missing} without a way although there is one, {extra} with a way although there is none", end="; ")
    for name, own in zip(("8", "16"), ratios.T, strict=True):
        print(f"cost beside {name} directions: median {np.median(own):.3f}, most {own.max():.3f}", end="; ")
    print(f"nearest obstacle {min(room):.2f} m; {seconds / given.pairs:.2f} s of processor time each")


if __name__ == "__main__":
    main()
