"""Draw the layers of a run side by side: hillshade, class, C_r, reasons.

python docs/pictures/layers.py RUN_FOLDER PICTURE.png
"""

import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import rasterio
from matplotlib.colors import LightSource, ListedColormap, LogNorm
from matplotlib.patches import Patch

from bumpymap.core.types import CLASS_NAMES, NO_CLASS, REASON_TEXT, Reason


def draw(folder: Path, picture: Path) -> None:
    """Draw four layers of the run in ``folder``."""
    with rasterio.open(folder / "rasters/heightmap.tif") as raster:
        heights, step = raster.read(1), raster.transform.a
        box = raster.bounds
    with rasterio.open(folder / "rasters/class.tif") as raster:
        class_id = raster.read(1)
        colours = [tuple(c / 255 for c in raster.colormap(1)[k]) for k in range(4)]
    with rasterio.open(folder / "rasters/reason.tif") as raster:
        reason, palette = raster.read(1, masked=True), raster.colormap(1)
    with rasterio.open(folder / "rasters/roughness.tif") as raster:
        c_r = raster.read(raster.descriptions.index("c_r") + 1)
    extent = (0, box.right - box.left, 0, box.top - box.bottom)
    wide = extent[1] > 1.2 * extent[3]
    figure, axes = plt.subplots(*((4, 1) if extent[1] > 2 * extent[3] else (2, 2)), figsize=(13, 10 if wide else 12))
    shade, rated, cost, why = axes.ravel()
    filled = np.where(np.isnan(heights), np.nanmedian(heights), heights)
    light = LightSource(azdeg=315, altdeg=45).hillshade(filled, dx=step, dy=step, fraction=1.0)
    shade.imshow(np.where(np.isnan(heights), np.nan, light), cmap="gray", extent=extent)
    shade.set_title("heightmap.tif, hillshade")
    rated.imshow(
        np.ma.masked_equal(class_id, NO_CLASS), cmap=ListedColormap(colours), vmin=-0.5, vmax=3.5, extent=extent
    )
    rated.set_title("class.tif")
    rated.legend(
        handles=[Patch(color=colours[k], label=f"{k} {CLASS_NAMES[k]}") for k in range(4)],
        loc="upper right",
        fontsize=8,
    )
    image = cost.imshow(c_r, norm=LogNorm(0.01, 1.0), cmap="viridis", extent=extent)
    cost.set_title("roughness.tif, c_r [rad/m]")
    figure.colorbar(image, ax=cost, shrink=0.8)
    shades = [tuple(c / 255 for c in palette[r]) for r in Reason]
    shown = [r for r in Reason if r != Reason.OK and np.ma.any(reason == r)]
    why.imshow(
        np.ma.masked_equal(reason, Reason.OK),
        cmap=ListedColormap(shades),
        vmin=-0.5,
        vmax=len(shades) - 0.5,
        extent=extent,
        interpolation="nearest",
    )
    why.set_title("reason.tif, why tiles have no class")
    if shown:
        why.legend(handles=[Patch(color=shades[r], label=REASON_TEXT[r]) for r in shown], loc="upper right", fontsize=8)
    for axis in axes.ravel():
        axis.set_aspect("equal")
    figure.tight_layout()
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=70)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
