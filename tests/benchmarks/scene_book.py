"""Draw the table of the made-up scenes: how much of what stands is closed, and how much level ground is barred."""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "helpers"))
from scenes import SCENES, judge, seen_from_above

from bumpymap.core import VehicleBody

BODY = VehicleBody(clearance_m=0.25, height_m=1.38, width_m=1.37, brush_stem_m=0.25)
DENSITIES = (200, 50, 20, 8, 4)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--sides", action="store_true", help="pulses lean, so that sides return too")
    parser.add_argument("--unclassified", action="store_true")
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    print("| scene | " + " | ".join(f"{density}" for density in DENSITIES) + " |")
    print("|---|" + "---|" * len(DENSITIES))
    for scene in SCENES:
        if given.only not in scene.name:
            continue
        seen = scene if given.sides else seen_from_above(scene)
        cells = []
        for density in DENSITIES:
            texts = []
            for noise in (0.0, 0.03):
                closed, barred = judge(
                    seen,
                    density,
                    noise,
                    BODY,
                    classified=not given.unclassified,
                    sides=given.sides,
                    seeds=range(given.seeds),
                )
                texts.append(("-" if np.isnan(closed) else f"{closed:.2f}") + (f" ({barred:.4f})" if barred else ""))
            cells.append(" / ".join(texts))
        print(f"| {scene.name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
