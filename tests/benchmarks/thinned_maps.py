"""Map a survey and random copies of it with fewer points, and hold the copies against the map of all points.

    python tests/benchmarks/thinned_maps.py SURVEY [--crs CRS] [--densities 10,6] [--noise 0] [--seed 1]
        [--ground]

A copy bars a tile if it is passable in the map of all points and not in that of the copy; unknown tiles of the copy
count as barred, and are named. It opens one that is barred, and not unknown, in the map of all points.

--noise adds errors to the heights of the copies [m]; --ground calls every point ground, so that both rate the objects
on it too. The ride is compared by thinned_ride.py.
"""

import argparse
import tempfile
from pathlib import Path

import laspy
import numpy as np

import bumpymap
from bumpymap.core import BARRED_TEXT, CROSSING_UNKNOWN, Barred

TEXTS = {text: code for code, text in BARRED_TEXT.items()}


def tiles_of(layers):
    """Return the tiles of a map by column and row, with the code of what bars each."""
    tiles = bumpymap.open(layers).tiles().set_index(["col", "row"])
    return tiles.assign(code=[TEXTS.get(text, Barred.NO) for text in tiles["barred"]])


def write_copy(survey, path, seed, *, share=1.0, noise=0.0, ground=False):
    """Write a random share of the points of a survey."""
    points, rng = laspy.read(survey), np.random.default_rng(seed)
    points.points = points.points[rng.random(len(points.points)) < share]
    points.z = np.asarray(points.z) + noise * rng.standard_normal(len(points.points))
    if ground:
        points.classification = np.full(len(points.points), 2, np.uint8)
    points.write(path)


def compare_passable(first, after):
    """Return the cells of what a copy bars and opens."""
    codes = after["code"].reindex(first.index, fill_value=Barred.UNKNOWN).to_numpy()
    before = first["code"].to_numpy()
    passable = codes[before == Barred.NO]
    was_closed = ~np.isin(before, (Barred.NO, *CROSSING_UNKNOWN))
    closed, opened = before[was_closed], before[was_closed & (codes == Barred.NO)]
    cells = [_share(passable != Barred.NO), _reasons(passable[passable != Barred.NO], passable)]
    return [*cells, _share(codes[was_closed] == Barred.NO), _reasons(opened, closed)]


def main():
    """Map, compare, print a line for each density."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("survey", type=Path)
    parser.add_argument("--crs")
    parser.add_argument("--densities", default="10,6", help="points per m2")
    parser.add_argument("--noise", default="0", help="standard deviation of errors that copies get, m")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ground", action="store_true", help="call all points ground")
    given = parser.parse_args()
    settings = {} if given.crs is None else {"crs": given.crs}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)

        def mapped(name, seed, **options):
            write_copy(given.survey, work / "copy.las", seed, ground=given.ground, **options)
            bumpymap.map_survey(work / "copy.las", work / name, **settings)
            return tiles_of(work / name)

        dense = mapped("dense", 0)
        density = dense["density"].mean()
        print("| points/m2 | passable tiles that it bars | by reason | barred tiles that it opens | by reason before |")
        print("|---|---|---|---|---|")
        for wanted in map(float, given.densities.split(",")):
            for noise in map(float, given.noise.split(",")):
                after = mapped(f"at_{wanted:g}_{noise:g}", given.seed, share=wanted / density, noise=noise)
                print("| " + " | ".join([f"{wanted:g}", *compare_passable(dense, after)]) + " |", flush=True)


def _share(marked):
    return f"{100 * np.mean(marked):.1f} % of {len(marked)}"


def _reasons(codes, of):
    counts = np.bincount(codes, minlength=len(Barred))
    return ", ".join(f"{BARRED_TEXT[Barred(code)]} {100 * n / len(of):.1f} %" for code, n in enumerate(counts) if n)


if __name__ == "__main__":
    main()
