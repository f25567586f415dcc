"""Make bumpymap/scan/data/models/stripes.json anew, and print the tables of stripes.md: python docs/models/stripes.py.

Takes some minutes and open3d. Scenes are those of seed 5150, each seen by one of the 64- and 128-line sensors.
"""

from pathlib import Path

import numpy as np

import bumpymap
from bumpymap.core import CLASSES, NOT_TRAVERSABLE, Scan, SectorStack
from bumpymap.lab import SENSORS, Label, make_scene, simulate_scan
from bumpymap.scan import classify_filter, fit_stripes, polar_sectors, save_stripes

SEED, TURNS, IN_A_ROW = 5150, 2, 7
"""Seven scenes, one of each theme, go to each sensor in turn, twice."""
OUT = Path(bumpymap.__file__).parent / "scan" / "data" / "models" / "stripes.json"


def look(index: int, name: str) -> SectorStack:
    """Cut the scan of one scene into sectors."""
    seen = simulate_scan(make_scene(SEED, index), SENSORS[name], index)
    there = (seen.points != 0).any(axis=1)
    return polar_sectors(Scan(seen.points[there], label=seen.label[there].astype(np.uint16)))


def main() -> None:
    """Fit, write, print."""
    names = [name for name in SENSORS if name.startswith(("64", "128"))]
    places = [(i, names[i // IN_A_ROW % len(names)]) for i in range(TURNS * IN_A_ROW * len(names))]
    stacks = [look(*place) for place in places]
    model = fit_stripes(stacks)
    save_stripes(model, OUT)
    print(f"{model.sectors:,} traversable sectors of {model.scans} scans")
    classed = [classify_filter(stack, model) for stack in stacks]
    class_id = np.concatenate([one.class_id for one in classed])
    variance, residual, label = (
        np.concatenate([getattr(stack, column) for stack in stacks]) for column in ("variance", "residual", "label")
    )
    for number in (*range(CLASSES), NOT_TRAVERSABLE):
        own = class_id == number
        centre = "" if number == NOT_TRAVERSABLE else f"{model.centres[number]:.2f}"
        print(f"| {number} | {centre} | {own.sum():,} | {variance[own].mean():.4f} | {np.nanmean(residual[own]):.4f} |")
    for name in (Label.TREE, Label.ASPHALT):
        counts = [int(((class_id == number) & (label == name)).sum()) for number in (*range(CLASSES), NOT_TRAVERSABLE)]
        print(f"{name.name}: of class 0, 1, 2, not traversable: {counts}")
    for name in names:
        own = [(stack, one) for (_, sensor), stack, one in zip(places, stacks, classed, strict=True) if sensor == name]
        alone = fit_stripes([stack for stack, _ in own])
        same = np.concatenate(
            [(classify_filter(stack, alone).class_id == one.class_id)[stack.traversable] for stack, one in own]
        )
        print(f"| {name} | {' | '.join(f'{centre:.2f}' for centre in alone.centres)} | {100 * same.mean():.1f} % |")


if __name__ == "__main__":
    main()
