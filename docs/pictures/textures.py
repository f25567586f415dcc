"""Draw docs/pages/img/textures.png, the file that is given: ten patches of each texture. Needs matplotlib."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bumpymap.core.types import TEXTURES
from bumpymap.lab.terrains import make_textures


def draw(picture: Path, columns: int = 10, seed: int = 7) -> None:
    """Draw ``columns`` patches of each texture."""
    figure = Figure(figsize=(columns, 1.06 * len(TEXTURES)), dpi=100)
    axes = figure.subplots(len(TEXTURES), columns)
    for line, texture in zip(axes, TEXTURES, strict=True):
        patches = make_textures(texture, columns, np.random.default_rng(seed))
        for axis, patch in zip(line, patches, strict=True):
            axis.imshow(patch, cmap="viridis", vmin=0, vmax=1)
            axis.set(xticks=[], yticks=[])
        line[0].set_ylabel(texture)
    figure.tight_layout(pad=0.4)
    figure.savefig(picture, metadata={"Software": None})


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
