"""The contact sheet of the four textures in the documentation: ``python -m bumpymap.learn.pictures OUT.png``."""

import sys
from pathlib import Path

import numpy as np

from bumpymap.errors import UsageError
from bumpymap.textures import make_textures
from bumpymap.types import TEXTURES

__all__ = ["contact_sheet"]


def contact_sheet(path: Path, columns: int = 10, seed: int = 7) -> None:
    """Draw a row of patches of each texture, heights as colour from low to high."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError("pictures need matplotlib. Install it with: pip install matplotlib") from error
    figure = Figure(figsize=(columns, 1.06 * len(TEXTURES)), dpi=100)
    axes = figure.subplots(len(TEXTURES), columns)
    for line, texture in zip(axes, TEXTURES, strict=True):
        patches = make_textures(texture, columns, np.random.default_rng(seed))
        for axis, patch in zip(line, patches, strict=True):
            axis.imshow(patch, cmap="viridis", vmin=0, vmax=1)
            axis.set(xticks=[], yticks=[])
        line[0].set_ylabel(texture)
    figure.tight_layout(pad=0.4)
    figure.savefig(path, metadata={"Software": None})


if __name__ == "__main__":
    contact_sheet(Path(sys.argv[1]))
