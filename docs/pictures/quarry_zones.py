"""Draw docs/pages/img/quarry_zones.png: the ground points of the sample site, its crowns and its zones.

Needs matplotlib.
"""

import sys
from pathlib import Path

import laspy
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LightSource
from scipy import ndimage
from scipy.stats import binned_statistic_2d

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "worlds"))

from made_quarry import BOUNDS, tiles_of

ROOT = Path(__file__).resolve().parents[2]
STEP = 0.15
SYMBOLS = "RWUXSP/BAfmo"
GROUND_CLASS, CROWN_CLASS = 2, 5
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


def heights_of(survey: laspy.LasData) -> np.ndarray:
    """Return the median height of the ground points of each pixel of ``STEP`` m, south first, without holes."""
    ground = (np.asarray(survey.classification) == GROUND_CLASS) & (np.asarray(survey.withheld) == 0)
    y, x, z = (np.asarray(survey[axis])[ground] for axis in "yxz")
    edges = (np.arange(BOUNDS.south, BOUNDS.north + STEP, STEP), np.arange(BOUNDS.west, BOUNDS.east + STEP, STEP))
    heights = binned_statistic_2d(y, x, z, "median", edges).statistic
    nearest = ndimage.distance_transform_edt(np.isnan(heights), return_distances=False, return_indices=True)
    return heights[tuple(nearest)]


def draw(target: Path) -> None:
    """Draw hillshade and zone outlines side by side."""
    box = BOUNDS
    survey = laspy.read(ROOT / "sample_data" / "quarry.laz")
    shade = LightSource(315, 40).hillshade(heights_of(survey), vert_exag=2.0, dx=STEP, dy=STEP)
    zones = np.ma.masked_all((round((box.north - box.south) / 3), round((box.east - box.west) / 3)))
    for number, symbol in enumerate(SYMBOLS):
        col, row = tiles_of(symbol)
        zones[row - round(box.south / 3), col - round(box.west / 3)] = number
    extent = (0.0, box.east - box.west, 0.0, box.north - box.south)
    figure, (left, right) = plt.subplots(1, 2, figsize=(16, 6.9), sharey=True, layout="constrained")
    left.imshow(shade, origin="lower", extent=extent, cmap="gray")
    left.set_title("ground points (hillshade, heights doubled) and tree crowns")
    right.imshow(shade, origin="lower", extent=extent, cmap="gray")
    right.imshow(zones, origin="lower", extent=extent, cmap="gist_rainbow", alpha=0.35, interpolation="nearest")
    right.set_title("zones, by tiles; grey: one surface fades into the next")
    crowns = np.asarray(survey.classification) == CROWN_CLASS
    left.plot(survey.x[crowns] - box.west, survey.y[crowns] - box.south, ",", color="#2e7d32")
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
    draw(ROOT / "docs" / "pages" / "img" / "quarry_zones.png")
