"""Draw map.qgs as QGIS shows it: the map, and the legend of the layers that are shown.

/usr/bin/python3 docs/pictures/map_qgs.py LAYERS PICTURE.png

It needs QGIS, which has the Python of the system, and Pillow there (Debian and Ubuntu: python3-qgis, python3-pil).
"""

import os
import sys
from pathlib import Path

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

from PIL import Image
from qgis.core import (
    QgsApplication,
    QgsLayoutExporter,
    QgsLayoutItemLegend,
    QgsLayoutItemMap,
    QgsLayoutItemScaleBar,
    QgsLayoutPoint,
    QgsLayoutSize,
    QgsLegendStyle,
    QgsPrintLayout,
    QgsProject,
    QgsUnitTypes,
)
from qgis.PyQt.QtCore import QRectF

PAGE = 240.0, 150.0
"""Width and height, mm."""
MAP_WIDTH = 158.0
DPI = 127
"""1200 pixels wide."""


def draw(folder: Path, picture: Path) -> None:
    """Draw the project of the run in ``folder``."""
    project = QgsProject.instance()
    if not project.read(str(folder / "map.qgs")):
        sys.exit(f"cannot open {folder / 'map.qgs'}: {project.error()}")
    layout = QgsPrintLayout(project)
    layout.initializeDefaults()
    layout.pageCollection().page(0).setPageSize(QgsLayoutSize(*PAGE))
    ground = QgsLayoutItemMap(layout)
    ground.attemptSetSceneRect(QRectF(2, 2, MAP_WIDTH, PAGE[1] - 4))
    shown = [node for node in project.layerTreeRoot().findLayers() if node.isVisible()]
    ground.setLayers([node.layer() for node in shown])
    extent = shown[-1].layer().extent()
    extent.scale(1.04)
    ground.zoomToExtent(extent)
    layout.addLayoutItem(ground)
    legend = QgsLayoutItemLegend(layout)
    legend.setTitle(project.title())
    legend.setAutoUpdateModel(False)
    root = legend.model().rootGroup()
    for node in root.findLayers():
        if node.layerId() not in {shown_node.layerId() for shown_node in shown}:
            node.parent().removeChildNode(node)
    for group in [group for group in root.findGroups() if not group.findLayers()]:
        root.removeChildNode(group)
    for part, size in (
        (QgsLegendStyle.Title, 14),
        (QgsLegendStyle.Group, 11),
        (QgsLegendStyle.Subgroup, 9),
        (QgsLegendStyle.SymbolLabel, 8),
    ):
        style = legend.style(part)
        font = style.font()
        font.setPointSize(size)
        style.setFont(font)
        legend.setStyle(part, style)
    legend.attemptMove(QgsLayoutPoint(MAP_WIDTH + 4, 2, QgsUnitTypes.LayoutMillimeters))
    layout.addLayoutItem(legend)
    bar = QgsLayoutItemScaleBar(layout)
    bar.setStyle("Single Box")
    bar.setLinkedMap(ground)
    bar.applyDefaultSize()
    layout.addLayoutItem(bar)
    bar.attemptMove(QgsLayoutPoint(MAP_WIDTH + 4, PAGE[1] - 18, QgsUnitTypes.LayoutMillimeters))
    if not QgsLayoutExporter(layout).renderPageToImage(0, dpi=DPI).save(str(picture)):
        sys.exit(f"cannot write {picture}")
    Image.open(picture).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(picture, optimize=True)


if __name__ == "__main__":
    application = QgsApplication([], True)
    application.initQgis()
    draw(Path(sys.argv[1]).resolve(), Path(sys.argv[2]))
