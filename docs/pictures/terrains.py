"""Draw docs/pages/img/terrains.png: the terrain library. Needs matplotlib."""

from pathlib import Path

import numpy as np
from matplotlib.colors import LightSource
from matplotlib.figure import Figure

from bumpymap.lab.terrains import KINDS, Terrain, make_terrain

FOLDER = Path(__file__).parents[1] / "pages" / "img"
SEED = 1
RELIEF_M = (0.15, 0.6)
"""Terrains of about this relief show their kind best."""


def typical(kind: str) -> Terrain:
    """Find the first terrain of a kind whose relief is in the range, on nearly level ground."""
    terrains = (make_terrain(kind, SEED, index, slope_limit_deg=0.01) for index in range(100))
    # A gentle half of the terrains lies on slopes up to 8 degrees; the other half is level here.
    level = (t for t in terrains if abs(t.surface[0].mean() - t.surface[-1].mean()) < RELIEF_M[0] / 2)
    return next((t for t in level if RELIEF_M[0] < np.ptp(t.surface) < RELIEF_M[1]), make_terrain(kind, SEED, 4))


def draw_kinds(picture: Path) -> None:
    """One shaded relief a kind."""
    figure = Figure(figsize=(9, 4.9), dpi=85, layout="constrained")
    light = LightSource(azdeg=315, altdeg=40)
    axes = figure.subplots(3, 6).ravel()
    for axis, kind in zip(axes, KINDS, strict=False):
        terrain = typical(kind)
        step = terrain.tile_size / len(terrain.surface)
        shade = light.hillshade(terrain.surface, vert_exag=1.5, dx=step, dy=step)
        axis.imshow(shade, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        axis.set_title(f"{kind}, {100 * np.ptp(terrain.surface):.0f} cm", fontsize=9)
    for axis in axes:
        axis.set_axis_off()
    figure.savefig(picture, metadata={"Software": None})


if __name__ == "__main__":
    draw_kinds(FOLDER / "terrains.png")
