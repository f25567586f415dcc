"""Compare sizes of pixels of the cost raster for other tools: time, bytes, and what their ways cost.

    python tests/benchmarks/cost_pixels.py LAYERS [--pairs 10] [--seed 1] [--grass GISBASE]

The finest raster is that of `bumpymap export --to cost`. Coarser ones hold the mean cost of their pixels; one is closed
where any of its pixels is, or, "by middles", where the one in its middle is. The coarsest is cost.tif of the layers.
Pairs of places lie at least 20 m apart in the largest piece of free ground of the finest; where a coarser raster closes
one of them, it has no way. scikit-image searches with MCP_Geometric, GRASS with r.cost (``--grass``: the folder that
holds bin/r.cost); times are processor time a way. The last column is the most that a way of scikit-image leads over
closed pixels of the finest raster.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from scipy.ndimage import label
from skimage.graph import MCP_Geometric

from bumpymap.layers import open_map
from bumpymap.views import ExportSettings, export_map

LEAST_M = 20.0
NO_WAY = (np.nan, np.nan, 0.0)


@dataclass
class CostRaster:
    """A raster of costs of a metre, NaN where closed."""

    name: str
    path: Path
    cost: np.ndarray
    transform: rasterio.Affine

    @classmethod
    def of(cls, name, path):
        with rasterio.open(path) as raster:
            return cls(name, path, raster.read(1), raster.transform)

    @property
    def pixel(self):
        return self.transform.a

    def place(self, x, y):
        col, row = ~self.transform @ (x, y)
        return int(row), int(col)

    def is_open(self, x, y):
        row, col = self.place(x, y)
        inside = 0 <= row < self.cost.shape[0] and 0 <= col < self.cost.shape[1]
        return inside and bool(np.isfinite(self.cost[row, col]))


def coarser(fine, block, folder, *, middles):
    """Write the finest raster in pixels of so many of its own."""
    rows, cols = (size // block * block for size in fine.cost.shape)
    parts = fine.cost[:rows, :cols].reshape(rows // block, block, cols // block, block)
    known = np.isfinite(parts)
    cost = np.where(known, parts, 0.0).sum(axis=(1, 3)) / np.maximum(known.sum(axis=(1, 3)), 1)
    shut = np.isnan(parts[:, block // 2, :, block // 2] if middles else parts.sum(axis=(1, 3)))
    cost[shut] = np.nan
    name = f"{block * fine.pixel:g} m" + (", by middles" if middles else "")
    path = folder / f"cost_{block}_{middles}.tif"
    with rasterio.open(fine.path) as raster:
        profile = {**raster.profile, "height": rows // block, "width": cols // block}
    profile["transform"] = fine.transform @ rasterio.Affine.scale(block)
    with rasterio.open(path, "w", **profile) as raster:
        raster.write(cost.astype(np.float32), 1)
    return CostRaster.of(name, path)


class Grass:
    """r.cost on one raster."""

    def __init__(self, base, raster, folder):
        self._raster = raster
        mapset = folder / "site" / "PERMANENT"
        mapset.mkdir(parents=True)
        rows, cols = raster.cost.shape
        west, north = raster.transform.c, raster.transform.f
        south, east = north - rows * raster.pixel, west + cols * raster.pixel
        region = {"proj": 0, "zone": 0, "north": north, "south": south, "east": east, "west": west, "cols": cols}
        region |= {"rows": rows, "e-w resol": raster.pixel, "n-s resol": raster.pixel}
        for name in ("DEFAULT_WIND", "WIND"):
            (mapset / name).write_text("".join(f"{key}: {value}\n" for key, value in region.items()))
        (folder / "rc").write_text(f"GISDBASE: {folder}\nLOCATION_NAME: site\nMAPSET: PERMANENT\nGUI: text\n")
        lib = os.pathsep.join([f"{base}/lib", os.environ.get("LD_LIBRARY_PATH", "")])
        path = f"{base}/bin{os.pathsep}{os.environ['PATH']}"
        self._settings = {"GISBASE": str(base), "GISRC": str(folder / "rc"), "LD_LIBRARY_PATH": lib, "PATH": path}
        self._run("r.in.gdal", "-o", f"input={raster.path}", "output=cost")

    def _run(self, *command):
        done = subprocess.run(command, env=os.environ | self._settings, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"{' '.join(command)}: {done.stderr}")
        return done.stdout

    def search(self, start, goal):
        """Return the cost of the cheapest way, m (NaN: none), the processor time, and NaN."""
        ends = [f"start_coordinates={start[0]},{start[1]}", f"stop_coordinates={goal[0]},{goal[1]}"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        self._run("r.cost", "--overwrite", "input=cost", "output=total", *ends)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        found = self._run("r.what", "map=total", f"coordinates={goal[0]},{goal[1]}").strip().split("|")[-1]
        spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return float("nan") if found == "*" else float(found) * self._raster.pixel, spent, float("nan")


def search_skimage(raster, start, goal, fine):
    """Return the cost of the cheapest way, m (NaN: none), the processor time, and its length on closed pixels, m."""
    begin = time.process_time()
    search = MCP_Geometric(np.where(np.isfinite(raster.cost), raster.cost, -1.0))
    first, last = raster.place(*start), raster.place(*goal)
    total = search.find_costs([first], [last])[0][last] * raster.pixel
    spent = time.process_time() - begin
    if not np.isfinite(total):
        return float("nan"), spent, 0.0
    row, col = np.array(search.traceback(last)).T + 0.5
    along = np.linspace(0.0, len(row) - 1.0, 20 * len(row))
    x, y = raster.transform @ (np.interp(along, np.arange(len(row)), col), np.interp(along, np.arange(len(row)), row))
    shut = [not fine.is_open(*place) for place in zip(x[1:].tolist(), y[1:].tolist(), strict=True)]
    return total, spent, float((np.hypot(np.diff(x), np.diff(y)) * shut).sum())


def draw_pairs(fine, count, rng):
    """Draw pairs of places, ((x, y), (x, y)) each."""
    pieces = label(np.isfinite(fine.cost))[0]
    largest = np.argwhere(pieces == np.bincount(pieces.ravel())[1:].argmax() + 1)
    pairs = []
    while len(pairs) < count:
        row, col = largest[rng.integers(len(largest), size=2)].T
        x, y = fine.transform @ (col + 0.5, row + 0.5)
        if np.hypot(x[1] - x[0], y[1] - y[0]) >= LEAST_M:
            pairs.append(list(zip(x.tolist(), y.tolist(), strict=True)))
    return pairs


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("layers", type=Path)
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--grass", type=Path, help="folder that holds bin/r.cost")
    given = parser.parse_args()
    site = open_map([given.layers])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        export_map(site, folder / "pixels", ExportSettings(to="cost"))
        fine = CostRaster.of(f"{site.grid.pixel_size:g} m", folder / "pixels" / "cost.tif")
        blocks = [site.grid.pixels // count for count in (5, 3)]
        rasters = [fine, *(coarser(fine, block, folder, middles=by) for by in (False, True) for block in blocks)]
        rasters.append(CostRaster.of(f"{site.grid.tile_size:g} m, cost.tif", given.layers / "cost.tif"))
        pairs = draw_pairs(fine, given.pairs, np.random.default_rng(given.seed))
        print(f"{len(pairs)} pairs\n\n| pixels | MB | tool | s a way | ways | cost, median | most | on closed, m |")
        print("|---|---|---|---|---|---|---|---|")
        best = {}
        for raster in rasters:
            tools = {"scikit-image": lambda *ends, raster=raster: search_skimage(raster, *ends, fine)}
            if given.grass is not None:
                tools["r.cost"] = Grass(given.grass.absolute(), raster, folder / raster.path.stem / raster.name).search
            for tool, search in tools.items():
                found = np.array(
                    [search(*pair) if all(raster.is_open(*end) for end in pair) else NO_WAY for pair in pairs]
                )
                best.setdefault(tool, found[:, 0])
                ratio = (found[:, 0] / best[tool])[np.isfinite(found[:, 0] / best[tool])]
                told = f"{np.median(ratio):.3f} | {ratio.max():.3f}" if len(ratio) else "- | -"
                size, ways = raster.path.stat().st_size / 1e6, int(np.isfinite(found[:, 0]).sum())
                closed = f"{found[:, 2].max():.1f}" if np.isfinite(found[:, 2]).all() else "-"
                told = f"{np.nanmedian(found[:, 1]):.3f} | {ways} | {told} | {closed}"
                print(f"| {raster.name} | {size:.2f} | {tool} | {told} |", flush=True)


if __name__ == "__main__":
    main()
