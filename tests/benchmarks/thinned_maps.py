"""Map a survey and random copies of it with fewer points, and hold the copies against the map of all points.

    python tests/benchmarks/thinned_maps.py SURVEY [--crs CRS] [--densities 10,6] [--noise 0] [--seed 1]
        [--ground]

A copy bars a tile if it is passable in the map of all points and not in that of the copy; unknown tiles of the copy
count as barred, and are named. It opens one that is barred, and not unknown, in the map of all points.

Then the ride: share of the tiles that the copy leaves unknown; rank, median error and ratio of its C_r (by third of
that of all points), and how often its 80 % interval holds the C_r of all points, of tiles on which fewer than half of
the drives fail. --noise adds errors to the heights of the copies [m]; --ground calls every point ground, so that both
rate the objects on it too.
"""

import argparse
import tempfile
from pathlib import Path

import laspy
import numpy as np
from scipy.stats import spearmanr

import bumpymap
from bumpymap.core import BARRED_TEXT, CROSSING_UNKNOWN, Barred

TEXTS = {text: code for code, text in BARRED_TEXT.items()}
HEAD = """
| points/m2 | noise | unknown | rank | median error | ratio by third | inside the interval, by third | all |
|---|---|---|---|---|---|---|---|"""


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


def compare_ride(first, after):
    """Return the cells of how the C_r of a copy agrees."""
    first = first[first["class"].notna()]
    both = first.join(after[["c_r", "c_r_low", "c_r_high", "class"]].add_suffix("_copy"))
    unknown = both["class_copy"].isna()
    both = both[~unknown & (both["p_fail"] < 0.5)]
    wanted, found = both["c_r"].to_numpy(), both["c_r_copy"].to_numpy()
    inside = (wanted >= both["c_r_low_copy"]) & (wanted <= both["c_r_high_copy"])
    third = np.searchsorted(np.quantile(wanted, [1 / 3, 2 / 3]), wanted)
    ratios = [np.median(found[third == k]) / np.median(wanted[third == k]) for k in range(3)]
    error = np.median(np.abs(np.log(found / wanted)))
    cells = [f"{100 * unknown.mean():.0f} %", f"{spearmanr(wanted, found).statistic:.3f}", f"{100 * error:.0f} %"]
    cells += [" / ".join(f"{value:.2f}" for value in ratios)]
    return [*cells, " / ".join(f"{inside[third == k].mean():.2f}" for k in range(3)), f"{inside.mean():.2f}"]


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
        rides = []
        print("| points/m2 | passable tiles that it bars | by reason | barred tiles that it opens | by reason before |")
        print("|---|---|---|---|---|")
        for wanted in map(float, given.densities.split(",")):
            for noise in map(float, given.noise.split(",")):
                after = mapped(f"at_{wanted:g}_{noise:g}", given.seed, share=wanted / density, noise=noise)
                print("| " + " | ".join([f"{wanted:g}", *compare_passable(dense, after)]) + " |", flush=True)
                rides.append([f"{wanted:g}", f"{100 * noise:g} cm", *compare_ride(dense, after)])
        print(HEAD, *("| " + " | ".join(cells) + " |" for cells in rides), sep="\n")


def _share(marked):
    return f"{100 * np.mean(marked):.1f} % of {len(marked)}"


def _reasons(codes, of):
    counts = np.bincount(codes, minlength=len(Barred))
    return ", ".join(f"{BARRED_TEXT[Barred(code)]} {100 * n / len(of):.1f} %" for code, n in enumerate(counts) if n)


if __name__ == "__main__":
    main()
