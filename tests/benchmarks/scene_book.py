"""Draw the table of the made-up scenes: how much of objects is closed, which gaps lead through, what is barred.

    python tests/benchmarks/scene_book.py [--seeds 4] [--only NAME] [--out docs/figures/scene_book.md]

Three figures a cell: surveyed from straight above with classes; with pulses that lean and see sides too; from straight
above without classes. All with noise of 3 cm. The page "How a tile is measured" shows the file of ``--out``.
"""

import argparse
import math
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "helpers"))
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


def share(value):
    """Write a share so that a trace is not a zero."""
    if math.isnan(value):
        return "-"
    return f"{value:.2f}" if value == 0.0 or value >= 0.005 else f"{value:.0e}".replace("e-0", "e-")


def table(scenes, seeds):
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


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4, help="places and headings of a scene (4)")
    parser.add_argument("--only", default="", help="scenes with this in their name")
    parser.add_argument("--out", type=Path, help="file for the table")
    given = parser.parse_args()
    chosen = [scene for scene in SCENES if given.only in scene.name and scene.name not in LEFT_OUT]
    text = "\n".join(table(chosen, given.seeds))
    print(text)
    if given.out is not None:
        given.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
