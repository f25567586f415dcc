"""Survey and map yards within walls, closed and with gaps, and count who gets out.

    python tests/benchmarks/rings.py [--rings 20] [--gaps 0,1,2,2.3] [--seed 1]

Walls are 2 m high and 0.1, 0.2 or 0.3 m thick, at any heading, surveyed with 50 or 20 points per m2, every other pair
of rings without classes. Routes, reach, scikit-image over both cost rasters and the values of Nav2's maps are asked.
"""

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "helpers"))
from ring_maps import TOOLS, Yard

THICKNESSES_M = (0.1, 0.2, 0.3)
DENSITIES = (50, 20)


def main():
    """Print a line of a table for each gap and kind of survey."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rings", type=int, default=20, help="for each gap")
    parser.add_argument("--gaps", default="0,1,2,2.3", help="m")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    columns = ("route", "reach", *TOOLS)
    print("| gap (m) | survey | points/m2 | rings | " + " | ".join(columns) + " |\n|" + "---|" * (4 + len(columns)))
    for gap in map(float, given.gaps.split(",")):
        rings, out = Counter(), Counter()
        for number in range(given.rings):
            yard = Yard(
                gap=gap,
                thickness=THICKNESSES_M[number % len(THICKNESSES_M)],
                density=DENSITIES[number % len(DENSITIES)],
                classified=number // 2 % 2 == 0,
                seed=1000 * given.seed + number,
            )
            kind = ("classified" if yard.classified else "without classes", yard.density)
            rings[kind] += 1
            with tempfile.TemporaryDirectory() as folder:
                layers = yard.map(Path(folder))
                found = {"route": yard.way_out(layers) is not None, "reach": yard.is_reached(layers)}
                found |= yard.crossed_by_tools(layers)
            out.update((kind, name) for name, is_out in found.items() if is_out)
        for kind in sorted(rings):
            cells = [f"{gap:g}", kind[0], f"{kind[1]}", f"{rings[kind]}", *(f"{out[kind, name]}" for name in columns)]
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
