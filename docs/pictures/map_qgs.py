"""Draw the page to print of a map.qgs, as QGIS does.

/usr/bin/python3 docs/pictures/map_qgs.py LAYERS PICTURE.png

It needs QGIS, which has the Python of the system, and Pillow there (Debian and Ubuntu: python3-qgis, python3-pil).
"""

import os
import sys
from pathlib import Path

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

from PIL import Image
from qgis.core import QgsApplication, QgsLayoutExporter, QgsProject

DPI = 103
"""1200 pixels wide."""


def draw(folder: Path, picture: Path) -> None:
    """Draw the project of the run in ``folder``."""
    project = QgsProject.instance()
    if not project.read(str(folder / "map.qgs")):
        sys.exit(f"cannot open {folder / 'map.qgs'}: {project.error()}")
    (layout,) = project.layoutManager().printLayouts()
    if not QgsLayoutExporter(layout).renderPageToImage(0, dpi=DPI).save(str(picture)):
        sys.exit(f"cannot write {picture}")
    Image.open(picture).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(picture, optimize=True)


if __name__ == "__main__":
    application = QgsApplication([], True)
    application.initQgis()
    draw(Path(sys.argv[1]).resolve(), Path(sys.argv[2]))
