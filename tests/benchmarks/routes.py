"""Time `bumpymap route` on made-up maps, beside scikit-image's least-cost path on the same costs.

python tests/benchmarks/routes.py --data FOLDER [--side 1000] [--way KM]

The first run makes the layers of SIDE x SIDE tiles in FOLDER. The command is timed as a whole: start, layers read, way
found, pulled tight and measured. scikit-image gets the costs in memory; only its search is timed.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
import rasterio
from _measure import run_timed
from rasterio.windows import Window
from scipy import ndimage

from bumpymap.core import BANDS, CLASS_NAMES
from bumpymap.layers import describe_file

TILE_M, PIXELS = 3.0, 3
WEST, NORTH = 480_000.0, 5_700_000.0
COST = {"ride_weight_m_per_rad": 5.0, "fail_weight_m": 300.0, "drive_m": 10.0, "slope_limit_deg": 30.0}
_STRIP = 512


def relief(rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
    """Ride cost of tiles, rad/m: waves of many lengths."""
    total = np.zeros((len(rows), len(cols)))
    rng = np.random.default_rng(1)
    for length in (900.0, 311.0, 97.0, 41.0, 17.0, 7.0):
        angle, phase = rng.uniform(0, 2 * np.pi, 2)
        total += np.sin(2 * np.pi / length * (np.cos(angle) * cols + np.sin(angle) * rows[:, None]) + phase)
    return 0.12 * np.exp(0.5 * total)


def make_layers(folder: Path, side: int) -> None:
    """Write the rasters and the manifest of a map of side x side tiles; a tenth of them is not passable."""
    folder.mkdir(parents=True)
    profiles = {
        "barred.tif": (1, "uint8", 255, 1),
        "cost.tif": (1, "float32", np.nan, 1),
        "roughness.tif": (len(BANDS), "float32", np.nan, 1),
        "heightmap.tif": (1, "float32", np.nan, PIXELS),
        "obstacle.tif": (1, "uint8", 255, PIXELS),
        "passage.tif": (1, "uint8", 255, PIXELS),
    }
    files = {name: _create(folder / name, side, *profile) for name, profile in profiles.items()}
    files["roughness.tif"].descriptions = [band.name for band in BANDS]
    rng = np.random.default_rng(2)
    closed = np.concatenate([rng.random((min(_STRIP, side - top), side)) < 0.1 for top in range(0, side, _STRIP)])
    for top in range(0, side, _STRIP):
        rows = np.arange(top, min(top + _STRIP, side))
        c_r = relief(rows, np.arange(side)).astype(np.float32)
        barred = np.where(closed[rows], 3, 0).astype(np.uint8)
        window = Window(0, top, side, len(rows))
        values = {band.name: np.full_like(c_r, 0.01) for band in BANDS} | {"c_r": c_r, "obstacle": 0 * c_r}
        cost = 1 + 5.0 * c_r - 300.0 * np.log1p(np.float32(-0.01)) / 10.0
        files["barred.tif"].write(barred[None], window=window)
        files["cost.tif"].write(np.where(barred == 0, cost, np.nan)[None].astype(np.float32), window=window)
        files["passage.tif"].write(
            _passage(closed, rows)[None], window=Window(0, top * PIXELS, side * PIXELS, len(rows) * PIXELS)
        )
        files["roughness.tif"].write(np.stack([values[band.name] for band in BANDS]), window=window)
    for file in files.values():
        file.close()
    _write_manifest(folder, list(profiles))


def _passage(closed: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return where the vehicle fits in some rows of tiles: all pixels that touch no closed tile."""
    first, last = max(rows[0] - 1, 0), rows[-1] + 2
    pixels = np.repeat(np.repeat(closed[first:last], PIXELS, 0), PIXELS, 1)
    free = ~ndimage.binary_dilation(pixels, np.ones((3, 3), bool))
    top = (rows[0] - first) * PIXELS
    return free[top : top + len(rows) * PIXELS].astype(np.uint8)


def _create(path: Path, side: int, bands: int, dtype: str, nodata: float, pixels: int) -> rasterio.io.DatasetWriter:
    transform = rasterio.Affine(TILE_M / pixels, 0, WEST, 0, -TILE_M / pixels, NORTH)
    shape = {"width": side * pixels, "height": side * pixels, "count": bands, "dtype": dtype, "nodata": nodata}
    layout = {"tiled": True, "blockxsize": 128, "blockysize": 128, "compress": "zstd", "sparse_ok": True}
    return rasterio.open(path, "w", "GTiff", crs="EPSG:32632", transform=transform, bigtiff="yes", **shape, **layout)


def _write_manifest(folder: Path, names: list[str]) -> None:
    from pyproj import CRS

    crs = CRS.from_epsg(32632)
    vehicle = {"name": "warthog", "width_m": 1.37, "height_m": 1.38, "clearance_m": 0.25, "speed_mps": 1.0}
    manifest = {
        "format": "bumpymap-run",
        "version": 1,
        "crs": {"name": crs.name, "code": "EPSG:32632", "wkt": crs.to_wkt()},
        "metres_per_unit": {"horizontal": 1.0, "vertical": 1.0},
        "grid": {"tile_size_m": TILE_M, "pixels": PIXELS},
        "cost": COST,
        "vehicle": vehicle,
        "calibration": {"id": "made-up", "vehicle": "warthog"},
        "settings": {"rating": "ride", "compat": "none"},
        "counts": dict.fromkeys(("tiles", "points", "passable", "unknown"), 0)
        | {"by_class": dict.fromkeys(CLASS_NAMES, 0), "by_reason": {}, "barred": {}},
        "files": [describe_file(folder / name) | {"path": name} for name in names],
    }
    (folder / "run.json").write_text(json.dumps(manifest), encoding="utf-8")


def ends_of(folder: Path, way_m: float) -> list[tuple[float, float]]:
    """Choose passable tiles on a diagonal, so far apart."""
    with rasterio.open(folder / "barred.tif") as file:
        side = file.width
        tiles = min(int(way_m / TILE_M / 2**0.5), side - 2)
        first = (side - tiles) // 2
        found = []
        for at in (first, first + tiles - 1):
            near = file.read(1, window=Window(max(at - 8, 0), max(at - 8, 0), 16, 16))
            row, col = np.argwhere(near == 0)[len(near) * 8 % max((near == 0).sum(), 1)]
            found.append(file.xy(max(at - 8, 0) + row, max(at - 8, 0) + col))
    return found


def main() -> int:
    """Make the map, time the command and scikit-image, print both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder for the made-up map")
    parser.add_argument("--side", type=int, default=1000, help="tiles along a side (1000)")
    parser.add_argument("--way", type=float, default=1e9, help="length of the way, km (corner to corner)")
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    folder = given.data / f"tiles_{given.side}"
    if not folder.exists():
        make_layers(folder, given.side)
    start, goal = ends_of(folder, given.way * 1000.0)
    command = [str(Path(sys.executable).with_name("bumpymap")), "route", str(folder), "--json"]
    command += ["--from", f"crs:{start[0]},{start[1]}", "--to", f"crs:{goal[0]},{goal[1]}"]
    runs = [run_timed(command, memory=number == 0) for number in range(given.rounds + 1)]
    sys.stdout.write(f"{runs[0].exit_code} {runs[0].stderr_tail[-400:]}\n")
    wall, user = (float(np.median([getattr(run, name) for run in runs[1:]])) for name in ("wall", "user"))
    sys.stdout.write(f"bumpymap route: {wall:.2f} s, {user:.2f} s user, peak {runs[0].peak / 1e9:.2f} GB\n")
    if given.side <= 3000:
        _compare(folder, start, goal, given.rounds)
    return 0


def _compare(folder: Path, start: tuple[float, float], goal: tuple[float, float], rounds: int) -> None:
    from skimage.graph import MCP_Geometric

    from bumpymap.route.search import find_way

    with rasterio.open(folder / "cost.tif") as file:
        cost = np.where(np.isnan(values := file.read(1)), np.inf, values).astype(np.float32)
        first, last = (file.index(*end) for end in (start, goal))
    times: dict[str, list[float]] = {"ours": [], "MCP_Geometric": []}
    for _ in range(rounds + 1):
        begin = time.process_time()
        way = find_way(cost, *((row + 0.5, col + 0.5) for row, col in (first, last)), margin=0.26)
        times["ours"].append(time.process_time() - begin)
        begin = time.process_time()
        search = MCP_Geometric(np.where(np.isinf(cost), -1.0, cost))
        total, _ = search.find_costs([first], [last])
        times["MCP_Geometric"].append(time.process_time() - begin)
    found = {name: float(np.median(values[1:])) for name, values in times.items()}
    dearer = total[last] / way.cost if way is not None else float("nan")
    sys.stdout.write(
        f"search alone: {found['ours']:.2f} s, MCP_Geometric {found['MCP_Geometric']:.2f} s; its way costs "
        f"{dearer:.4f} of ours\n"
    )


if __name__ == "__main__":
    sys.exit(main())
