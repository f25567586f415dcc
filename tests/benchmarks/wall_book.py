"""Draw the table of steps across a site: ways over them, rows of tiles without a barred one, and tiles barred far away.

    python tests/benchmarks/wall_book.py [--places 30] [--densities 10 400] [--out FILE]

Level ground that is higher on one side, or has a ditch, seen from above alone, all points without class; at so many
places in a tile and five headings. No files are written: the tiles are rated in memory, and the pixels on which the
middle of the Warthog can be are followed from one side to the other. 30 places take three minutes on two idle cores.
"""

import argparse
import sys
import tempfile
from itertools import product
from multiprocessing import Pool
from pathlib import Path

import numpy as np
from scipy.ndimage import label

sys.path += [str(Path(__file__).parents[1] / folder) for folder in ("helpers", "worlds")]
from bumpymap.core.config import MapConfig
from bumpymap.core.interrupts import SilentProgress
from bumpymap.core.types import OPEN_THROUGH, Barred, Georeference, rated_columns
from bumpymap.survey.second_pass import NeighbourRating, finish_tiles
from bumpymap.survey.tile_rating import RatingModels, TileRating
from bumpytiles import Grid, TileBuckets, TileTable

TILES, MARGIN = 12, 1
SIDE_M = 3.0 * TILES
WEST, SOUTH = 600_000.0, 4_000_002.0
HEADINGS_DEG = (0.0, 90.0, 30.0, 45.0, 71.0)
DITCH_M = 1.5
GROUND = {
    **{f"step {height:g} m": (height, np.inf) for height in (0.45, 0.6, 1.0, 2.0)},
    "ditch 1 m deep": (-1.0, DITCH_M),
    "kerb .1 m": (0.1, np.inf),
    "step .2 m": (0.2, np.inf),
    "ditch .3 m wide and deep": (-0.3, 0.3),
    "ditch .3 m wide, 1 m deep": (-1.0, 0.3),
}
"""Height beyond a line [m], and how far beyond it [m]."""
RAMPS = {"ramp 15 degrees": 15.0, "ramp 20 degrees": 20.0}
DRIVABLE = ("kerb .1 m", "step .2 m", "ditch .3 m wide and deep", "ditch .3 m wide, 1 m deep", *RAMPS)
DENSITIES = (400, 200, 100, 50, 20, 10)


def rated_tiles(points, folder):
    """Rate easting, northing and height of points, all of them ground or not, as a map does; return the columns."""
    config = MapConfig((folder / "none.laz",), folder)
    models, grid = RatingModels.load(config), Grid()
    buckets = TileBuckets(grid)
    buckets.add(*points, np.zeros(len(points[0]), np.bool_))
    rating = TileRating.of(config, models, Georeference(None))
    blocks = [rating(block, False) for block in buckets.blocks()]
    columns = {c.name: np.concatenate([block[c.name] for block in blocks]) for c in rated_columns(grid.pixels)}
    neighbours = NeighbourRating(config, models.calibration)
    table = finish_tiles(TileTable.of(grid, columns), neighbours, folder, 1, SilentProgress())
    return table.read(("col", "row", "barred", "passage"))


def judge(case):
    """Return whether a way leads over a line, rows of tiles that it crosses unbarred, and tiles barred elsewhere."""
    kind, density, number = case
    rng = np.random.default_rng((number, density))
    turn = np.radians(HEADINGS_DEG[number % len(HEADINGS_DEG)])
    middle = 0.5 * SIDE_M + rng.uniform(-1.5, 1.5, 2)
    x, y = rng.uniform(0.0, SIDE_M, (2, rng.poisson(density * SIDE_M**2)))

    def beyond(x, y):
        return (x - middle[0]) * np.cos(turn) + (y - middle[1]) * np.sin(turn)

    far = beyond(x, y)
    if kind in RAMPS:
        z = np.clip(far * np.tan(np.radians(RAMPS[kind])), 0.0, 1.0)
    else:
        height, width = GROUND[kind]
        z = np.where((far > 0.0) & (far < width), height, 0.0)
    z = z + rng.normal(0.0, 0.003, len(x)) + 50.0
    with tempfile.TemporaryDirectory() as folder:
        found = rated_tiles((x + WEST, y + SOUTH, z), Path(folder))
    line, column = TILES - 1 - (found["row"] - round(SOUTH / 3.0)), found["col"] - round(WEST / 3.0)
    barred, areas = np.full((TILES, TILES), Barred.UNKNOWN), np.zeros((TILES, TILES, 15, 15), np.uint8)
    barred[line, column], areas[line, column] = found["barred"], found["passage"]
    away = beyond(3.0 * np.arange(TILES) + 1.5, SIDE_M - 3.0 * np.arange(TILES)[:, None] - 1.5)
    inner = np.zeros_like(barred, np.bool_)
    inner[MARGIN:-MARGIN, MARGIN:-MARGIN] = True
    free = np.isin(barred, OPEN_THROUGH)[..., None, None] & (areas > 0)
    wide = GROUND[kind][1] if kind in GROUND and np.isfinite(GROUND[kind][1]) else 0.0
    is_way = _joins(free.swapaxes(1, 2).reshape(TILES * 15, TILES * 15), beyond, wide)
    over_tiles = _joins((barred == Barred.NO) & inner, beyond, wide)
    return (
        is_way,
        over_tiles,
        int(((barred != Barred.NO) & inner & (np.abs(away - 0.5 * wide) > 4.5)).sum()),
        int(((barred != Barred.NO) & inner).sum()),
    )


def _joins(free, beyond, wide):
    """Return whether free cells on one side of the line hang together with those on the other."""
    size = SIDE_M / len(free)
    middles = (np.arange(len(free)) + 0.5) * size
    away = beyond(middles, (SIDE_M - middles)[:, None])
    pieces = label(free, np.ones((3, 3)))[0]
    before, behind = (np.unique(pieces[free & side]) for side in (away < -3.0, away > wide + 3.0))
    return bool(np.intersect1d(before, behind).size)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--places", type=int, default=30, help="places in a cell (30)")
    parser.add_argument("--kinds", default="", help="kinds with this in their name")
    parser.add_argument("--densities", type=int, nargs="+", default=DENSITIES, help="points per m2")
    parser.add_argument("--out", type=Path, help="file for the table")
    given = parser.parse_args()
    lines = ["| ground | " + " | ".join(map(str, given.densities)) + " |", "|---" * (len(given.densities) + 1) + "|"]
    with Pool(2) as pool:
        for kind in (kind for kind in (*GROUND, *RAMPS) if given.kinds in kind):
            cells = []
            for density in given.densities:
                cases = product([kind], [density], range(given.places))
                ways, over_tiles, far, barred = np.array(pool.map(judge, list(cases), chunksize=1)).sum(axis=0).tolist()
                cells.append(f"{barred} tiles" if kind in DRIVABLE else f"{ways} / {over_tiles} / {far}")
            what = "barred" if kind in DRIVABLE else "ways on pixels / over tiles / tiles barred far away"
            lines.append(f"| {kind}: {what} | " + " | ".join(cells) + " |")
            print(lines[-1], file=sys.stderr, flush=True)
    text = "\n".join([f"Of {given.places} places in each cell, by points per m2:", "", *lines])
    print(text)
    if given.out is not None:
        given.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
