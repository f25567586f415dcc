"""Draw the table of the rings: ways out of closed ones, and open ones out of which no way is found.

    python tests/benchmarks/ring_book.py [--rings 20] [--kinds wall] [--densities 10 50] [--out FILE]

A closed ring and one with an opening of 1.5, 2 and 3 times the Warthog's width, at noise of 0, 2 and 5 cm, from above
alone and with sides, with and without ground classes, in turns. A ring takes 0.4 s, and all of them 20 minutes on two
idle cores.
"""

import argparse
import sys
import tempfile
from itertools import product
from multiprocessing import Pool
from pathlib import Path

sys.path += [str(Path(__file__).parents[1] / folder) for folder in ("helpers", "worlds")]
from rings import GROUND_KINDS, STANDING_KINDS, Ring

WIDTH_M = 1.37
DENSITIES = (4, 10, 16, 25, 35, 50, 100, 400)
OPENINGS = (0.0, 1.5, 2.0, 3.0)


def ring_of(kind, opening, density, seed):
    """Return the ring of a cell with a number; a ring of its own for each way of surveying."""
    noise, sides, classified = (0.0, 0.02, 0.05)[seed % 3], bool(seed // 3 % 2), bool(seed // 6 % 2)
    if kind in GROUND_KINDS:
        classified = False
    return Ring(kind, opening * WIDTH_M, density, noise, classified, sides, seed=seed)


def judge(ring):
    """Return whether a way is found, and whether it leaves elsewhere than by the opening."""
    with tempfile.TemporaryDirectory() as folder:
        route = ring.way_out(ring.map(Path(folder), threads=1))
    return route is not None, route is not None and ring.opening_m > 0 and not ring.leads_through(route)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rings", type=int, default=20, help="in a cell (20)")
    parser.add_argument("--kinds", default="", help="kinds with this in their name")
    parser.add_argument("--densities", type=float, nargs="+", default=DENSITIES, help="points per m2")
    parser.add_argument("--out", type=Path, help="file for the table")
    given = parser.parse_args()
    kinds = [kind for kind in (*STANDING_KINDS, *GROUND_KINDS) if given.kinds in kind]
    heads = ["closed: a way", *(f"open {opening:g} x: no way + elsewhere" for opening in OPENINGS[1:])]
    lines = [f"| ring | {' | '.join(heads)} |", "|---" * len(("ring", *heads)) + "|"]
    with Pool(2) as pool:
        for kind in kinds:
            cells = []
            for opening, density in product(OPENINGS, given.densities):
                rings = [ring_of(kind, opening, density, seed) for seed in range(given.rings)]
                found = pool.map(judge, rings, chunksize=1)
                wrong = sum(way == (opening == 0) for way, _ in found)
                elsewhere = sum(other for _, other in found)
                cells.append(f"{wrong}" + (f" + {elsewhere}" if elsewhere else ""))
            size = len(given.densities)
            by_opening = (", ".join(cells[at : at + size]) for at in range(0, len(cells), size))
            lines.append(f"| {kind} | " + " | ".join(by_opening) + " |")
            print(lines[-1], file=sys.stderr, flush=True)
    places = ", ".join(f"{density:g}" for density in given.densities)
    text = "\n".join([f"Of {given.rings} rings in each cell, at {places} points per m2:", "", *lines])
    print(text)
    if given.out is not None:
        given.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
