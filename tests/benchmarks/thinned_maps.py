"""Map a survey and random copies of it with fewer points, and count the tiles that a copy bars or opens.

    python tests/benchmarks/thinned_maps.py SURVEY [--crs CRS] [--densities 10,6] [--seed 1] [--dense LAYERS] [--twin]

A copy bars a tile if it is passable in the map of all points and not in that of the copy; unknown tiles of the copy
count as barred, and are named. It opens one that is barred, and not unknown, in the map of all points. With --twin the
copy is held against another of its density: so much is due to chance alone.
"""

import argparse
import tempfile
from pathlib import Path

import laspy
import numpy as np
import rasterio

import bumpymap
from bumpymap.core import BARRED_TEXT, Barred

NODATA = 255


def barred_tiles(layers):
    """Return what bars each tile, by column and row."""
    with rasterio.open(layers / "rasters/barred.tif") as file:
        codes, transform = file.read(1), file.transform
    row, col = np.nonzero(codes != NODATA)
    west, north = round(transform.c / transform.a), round(transform.f / -transform.e)
    return dict(zip(zip((west + col).tolist(), (north - row).tolist(), strict=True), codes[row, col], strict=True))


def write_copy(survey, share, seed, path):
    """Write a random share of the points of a survey."""
    points = laspy.read(survey)
    points.points = points.points[np.random.default_rng(seed).random(len(points.points)) < share]
    points.write(path)


def main():
    """Map, compare, print a line for each density."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("survey", type=Path)
    parser.add_argument("--crs")
    parser.add_argument("--densities", default="10,6", help="points per m2")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--dense", type=Path, help="layers of all points, if they were mapped")
    parser.add_argument("--twin", action="store_true", help="hold each copy against another of its density")
    given = parser.parse_args()
    settings = {} if given.crs is None else {"crs": given.crs}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        dense = given.dense or work / "dense"
        if given.dense is None:
            bumpymap.map_survey(given.survey, dense, **settings)
        before = barred_tiles(dense)
        with rasterio.open(dense / "rasters/roughness.tif") as file:
            density = np.nanmean(file.read(file.descriptions.index("density") + 1))
        print("| points/m2 | passable tiles that it bars | by reason | barred tiles that it opens | by reason before |")
        print("|---|---|---|---|---|")
        for wanted in map(float, given.densities.split(",")):
            maps = []
            for seed in (given.seed, given.seed + 1)[: 1 + given.twin]:
                write_copy(given.survey, wanted / density, seed, work / "copy.las")
                bumpymap.map_survey(work / "copy.las", work / f"at_{wanted:g}_{seed}", **settings)
                maps.append(barred_tiles(work / f"at_{wanted:g}_{seed}"))
            after = maps[0]
            first = maps[1] if given.twin else before
            pairs = np.array([(code, after.get(tile, Barred.UNKNOWN)) for tile, code in first.items()])
            passable = pairs[pairs[:, 0] == Barred.NO, 1]
            closed = pairs[~np.isin(pairs[:, 0], (Barred.NO, Barred.UNKNOWN))]
            opened = closed[closed[:, 1] == Barred.NO, 0]
            cells = [f"{wanted:g}", _share(passable != Barred.NO), _reasons(passable[passable != Barred.NO], passable)]
            cells += [_share(closed[:, 1] == Barred.NO), _reasons(opened, closed)]
            print("| " + " | ".join(cells) + " |", flush=True)


def _share(marked):
    return f"{100 * np.mean(marked):.1f} % of {len(marked)}"


def _reasons(codes, of):
    counts = np.bincount(codes, minlength=len(Barred))
    return ", ".join(f"{BARRED_TEXT[Barred(code)]} {100 * n / len(of):.1f} %" for code, n in enumerate(counts) if n)


if __name__ == "__main__":
    main()
