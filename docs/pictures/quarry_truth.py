"""Draw docs/pages/img/quarry_truth.png: the relief of the sample site, and its zones. Needs matplotlib."""

import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LightSource
from matplotlib.patches import Circle

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "worlds"))

from made_quarry import BOUNDS, TREES, ZONES, height, zone_at

STEP = 0.1
LABELS = {
    "road": (20, 27),
    "washboard": (64, 28),
    "ruts": (104, 22.5),
    "ramp": (19, 63),
    "pond": (37, 61.5),
    "pad": (67.4, 51.8),
    "rubble": (99, 53),
    "bank": (84, 77),
    "stockpile": (43, 45),
    "meadow": (75, 93),
    "floor": (5, 45),
}


def draw(target: Path) -> None:
    """Draw hillshade and zone outlines side by side."""
    box = BOUNDS
    easting = np.arange(box.west + STEP / 2, box.east, STEP)
    northing = np.arange(box.south + STEP / 2, box.north, STEP)
    east, north = np.meshgrid(easting, northing)
    shade = LightSource(315, 40).hillshade(height(east, north), vert_exag=2.0, dx=STEP, dy=STEP)
    zones = np.searchsorted(sorted(ZONES), zone_at(east, north))
    extent = (0.0, box.east - box.west, 0.0, box.north - box.south)
    figure, (left, right) = plt.subplots(1, 2, figsize=(16, 6.9), sharey=True, layout="constrained")
    left.imshow(shade, origin="lower", extent=extent, cmap="gray")
    left.set_title("relief (hillshade, heights doubled) and tree crowns")
    right.imshow(shade, origin="lower", extent=extent, cmap="gray")
    colours = np.ma.masked_equal(zones, sorted(ZONES).index("transition"))
    right.imshow(colours, origin="lower", extent=extent, cmap="gist_rainbow", alpha=0.35, interpolation="nearest")
    right.set_title("zones; grey: one surface fades into the next")
    for tree in TREES:
        left.add_patch(Circle((tree.easting - box.west, tree.northing - box.south), tree.radius, color="#2e7d32"))
    for name, (x, y) in LABELS.items():
        right.text(x, y, name, ha="center", va="center", fontsize=11, color="black")
    right.annotate("step", (77.5, 60.5), (83, 66.5), arrowprops={"arrowstyle": "->"}, fontsize=11, va="center")
    for axes in (left, right):
        axes.set_xlim(extent[:2])
        axes.set_ylim(extent[2:])
        axes.set_xlabel(f"m east of {box.west:,.0f}")
    left.set_ylabel(f"m north of {box.south:,.0f}")
    figure.savefig(target, dpi=75)


if __name__ == "__main__":
    draw(Path(__file__).parents[1] / "pages" / "img" / "quarry_truth.png")
