"""Draw docs/pages/img/terrains.png and scan_effects.png: the terrain library, and what a survey sees of it.

Needs matplotlib.
"""

from pathlib import Path

import numpy as np
from matplotlib.colors import LightSource
from matplotlib.figure import Figure

from bumpymap.lab.worlds.terrains import KINDS, ScanEffects, Terrain, make_terrain, survey_terrain

FOLDER = Path(__file__).parents[1] / "pages" / "img"
SEED = 1
BLUE = "#3b73b9"
RELIEF_M = (0.15, 0.6)
"""Terrains of about this relief show their kind best."""
FROM_THE_SIDE = (
    ("100 points per m², no fault", ScanEffects(100)),
    ("noise of 3 cm", ScanEffects(100, noise_m=0.03)),
    ("smoothed over 0.15 m", ScanEffects(100, smoothing_m=0.15)),
    ("shared noise of 3 cm, over 0.3 m", ScanEffects(100, noise_m=0.03, noise_length_m=0.3)),
)
FROM_ABOVE = (
    ("10 points per m²", ScanEffects(10)),
    ("a quarter in holes", ScanEffects(100, hole_share=0.25)),
)


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


def draw_effects(picture: Path) -> None:
    """Points of one kerb under each effect: seen along the kerb, or from above."""
    middle = (np.arange(60) + 0.5) * 0.05 - 1.5
    step = 0.15 / (1 + np.exp(-middle / 0.015))
    terrain = Terrain("kerb", np.broadcast_to(step, (60, 60)).copy(), 3.0)
    figure = Figure(figsize=(9, 3.9), dpi=85, layout="constrained")
    axes = figure.subplots(2, 3, width_ratios=(3, 3, 2))
    for axis, (name, effects) in zip(axes[:, :2].ravel(), FROM_THE_SIDE, strict=True):
        points = survey_terrain(terrain, effects, np.random.default_rng(SEED))
        axis.plot(points.easting, points.upward, ".", color=BLUE, markersize=2, alpha=0.6)
        axis.plot(middle + 1.5, terrain.surface[0], color="#b03a48", linewidth=0.8)
        axis.set(ylim=(-0.12, 0.26), ylabel="height [m]")
        axis.set_title(name, fontsize=9)
    for axis, (name, effects) in zip(axes[:, 2], FROM_ABOVE, strict=True):
        points = survey_terrain(terrain, effects, np.random.default_rng(SEED))
        axis.plot(points.easting, points.northing, ".", color=BLUE, markersize=2)
        axis.set(aspect="equal", xlim=(0, 3), ylim=(0, 3))
        axis.set_title(name, fontsize=9)
    figure.savefig(picture, metadata={"Software": None})


if __name__ == "__main__":
    draw_kinds(FOLDER / "terrains.png")
    draw_effects(FOLDER / "scan_effects.png")
