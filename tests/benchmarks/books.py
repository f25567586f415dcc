"""Draw the tables of made-up scenes and of rings: what is closed, which gaps lead through, what is barred.

    python tests/benchmarks/books.py scenes [--seeds 4] [--only NAME] [--out docs/figures/scene_book.md]
    python tests/benchmarks/books.py rings [--seeds 20] [--only wall] [--densities 10 50] [--out FILE]

Scenes have three figures a cell: surveyed from straight above with classes; with pulses that lean and see sides too;
from straight above without classes. All with noise of 3 cm. "How a tile is measured" shows the file of ``--out``.

Rings: ways out of closed ones, and open ones out of which no way is found. A closed ring and one with an opening of
1.5, 2 and 3 times the Warthog's width, at noise of 0, 2 and 5 cm, from above alone and with sides, with and without
ground classes, in turns. A ring takes 0.4 s, and all of them 20 minutes on two idle cores.
"""

import argparse
import math
import sys
import tempfile
from itertools import product
from multiprocessing import Pool
from pathlib import Path

sys.path += [str(Path(__file__).parents[1] / folder) for folder in ("helpers", "worlds")]
from rings import GROUND_KINDS, STANDING_KINDS, Ring
from scenes import SCENES, judge, seen_from_above

from bumpymap.core import VehicleBody

BODY = VehicleBody(clearance_m=0.25, height_m=1.38, width_m=1.37, brush_stem_m=0.25)
DENSITIES = (200, 20, 8, 4)
SURVEYS = ({}, {"sides": True}, {"classified": False})
NOISE_M = 0.03
LEFT_OUT = {
    *("wall 0.2 m", "wall 0.6 m", "low wall 0.6 m high", "bales", "carport", "hut, unassigned", "crowns, unassigned"),
    *("footbridge 1 m above ground, unassigned", "ring of wall 0.3 m, gap 1 m", "ditch", "ramp"),
}
"""Scenes between others of the table, or like one of them."""
RING_DENSITIES = (4, 10, 16, 25, 35, 50, 100, 400)
OPENINGS = (0.0, 1.5, 2.0, 3.0)


def share(value):
    """Write a share so that a trace is not a zero."""
    if math.isnan(value):
        return "-"
    return f"{value:.2f}" if value == 0.0 or value >= 0.005 else f"{value:.0e}".replace("e-0", "e-")


def scene_table(scenes, seeds):
    """Return the lines of the table."""
    lines = ["| scene | 200 points/m2 | 20 | 8 | 4 |", "|---|" + "---|" * len(DENSITIES)]
    gaps, most = [], [[0.0] * len(SURVEYS) for _ in DENSITIES]
    for scene in scenes:
        cells, ways = [], []
        for at, density in enumerate(DENSITIES):
            found = [
                judge(
                    scene if settings.get("sides") else seen_from_above(scene),
                    *(density, NOISE_M, BODY),
                    **settings,
                    seeds=range(seeds),
                )
                for settings in SURVEYS
            ]
            has_crowns = scene.name.startswith("crowns")
            asked = [
                one.barred if has_crowns else one.relief if math.isnan(one.closed) else one.closed for one in found
            ]
            cells.append(" / ".join(map(share, asked)))
            ways.append(" / ".join(share(one.joined) for one in found))
            if not has_crowns:
                most[at] = [max(pair) for pair in zip(most[at], (one.barred for one in found), strict=True)]
        if scene.name.startswith("ring"):  # their walls are those of "wall 0.3 m"
            gaps.append(f"| *way through*: {scene.name} | " + " | ".join(ways) + " |")
        elif "-" not in cells[0]:
            lines.append(f"| {scene.name} | " + " | ".join(cells) + " |")
        print(lines[-1], file=sys.stderr, flush=True)
    level = " | ".join(" / ".join(map(share, row)) for row in most)
    return [*lines, *gaps, f"| *level ground*, most of any scene | {level} |"]


def ring_of(kind, opening, density, seed):
    """Return the ring of a cell with a number; a ring of its own for each way of surveying."""
    noise, sides, classified = (0.0, 0.02, 0.05)[seed % 3], bool(seed // 3 % 2), bool(seed // 6 % 2)
    if kind in GROUND_KINDS:
        classified = False
    return Ring(kind, opening * BODY.width_m, density, noise, classified, sides, seed=seed)


def judge_ring(ring):
    """Return whether a way is found, and whether it leaves elsewhere than by the opening."""
    with tempfile.TemporaryDirectory() as folder:
        route = ring.way_out(ring.map(Path(folder), threads=1))
    return route is not None, route is not None and ring.opening_m > 0 and not ring.leads_through(route)


def ring_table(kinds, densities, count):
    """Return the lines of the table of rings, ``count`` in each cell."""
    heads = ["closed: a way", *(f"open {opening:g} x: no way + elsewhere" for opening in OPENINGS[1:])]
    lines = [f"| ring | {' | '.join(heads)} |", "|---" * len(("ring", *heads)) + "|"]
    with Pool(2) as pool:
        for kind in kinds:
            cells = []
            for opening, density in product(OPENINGS, densities):
                rings = [ring_of(kind, opening, density, seed) for seed in range(count)]
                found = pool.map(judge_ring, rings, chunksize=1)
                wrong = sum(way == (opening == 0) for way, _ in found)
                elsewhere = sum(other for _, other in found)
                cells.append(f"{wrong}" + (f" + {elsewhere}" if elsewhere else ""))
            size = len(densities)
            by_opening = (", ".join(cells[at : at + size]) for at in range(0, len(cells), size))
            lines.append(f"| {kind} | " + " | ".join(by_opening) + " |")
            print(lines[-1], file=sys.stderr, flush=True)
    places = ", ".join(f"{density:g}" for density in densities)
    return [f"Of {count} rings in each cell, at {places} points per m2:", "", *lines]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("book", choices=("scenes", "rings"))
    parser.add_argument("--seeds", type=int, help="places and headings of a scene (4), rings in a cell (20)")
    parser.add_argument("--only", default="", help="scenes or rings with this in their name")
    parser.add_argument("--densities", type=float, nargs="+", default=RING_DENSITIES, help="points per m2, of rings")
    parser.add_argument("--out", type=Path, help="file for the table")
    given = parser.parse_args()
    if given.book == "scenes":
        chosen = [scene for scene in SCENES if given.only in scene.name and scene.name not in LEFT_OUT]
        lines = scene_table(chosen, given.seeds or 4)
    else:
        kinds = [kind for kind in (*STANDING_KINDS, *GROUND_KINDS) if given.only in kind]
        lines = ring_table(kinds, given.densities, given.seeds or 20)
    text = "\n".join(lines)
    print(text)
    if given.out is not None:
        given.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
