"""Load layers and a project as QGIS does when a user drags them in, and report what came of it as JSON.

/usr/bin/python3 load_in_qgis.py FOLDER REPORT.json
"""

import json
import os
import sys
from pathlib import Path

os.environ["QT_QPA_PLATFORM"] = "offscreen"

from qgis.core import (
    Qgis,
    QgsApplication,
    QgsExpressionContextUtils,
    QgsMapRendererParallelJob,
    QgsMapSettings,
    QgsProject,
    QgsRasterLayer,
    QgsRenderContext,
    QgsVectorLayer,
)
from qgis.gui import QgsMapCanvas
from qgis.PyQt.QtCore import QSize
from qgis.PyQt.QtGui import QColor

SIZE = 1200, 1000
"""Width and height of pictures, pixels."""


def describe(layer):
    """Name, renderer, CRS, extent, blending and legend of a layer."""
    found = {"name": layer.name(), "valid": layer.isValid()}
    if not layer.isValid():
        return found | {"error": layer.error().summary()}
    found |= {
        "source": layer.source(),
        "crs": layer.crs().authid(),
        "crs_valid": layer.crs().isValid(),
        "extent": corners(layer.extent()),
        "renderer": layer.renderer().type(),
        "multiply": layer.blendMode() == 13,  # QPainter.CompositionMode_Multiply
    }
    return found | (describe_raster(layer) if isinstance(layer, QgsRasterLayer) else describe_areas(layer))


def describe_raster(layer):
    renderer = layer.renderer()
    found = {
        "bands": renderer.usesBands(),
        "legend": [[label, colour.name(), colour.alpha()] for label, colour in renderer.legendSymbologyItems()],
    }
    if renderer.type() == "paletted":
        found["values"] = [int(entry.value) for entry in renderer.classes()]
    elif renderer.type() == "singlebandpseudocolor":
        shader = renderer.shader().rasterShaderFunction()
        found["values"] = [item.value for item in shader.colorRampItemList()]
    return found


def describe_areas(layer):
    items = layer.renderer().legendSymbolItems()
    legend = [[item.label(), item.symbol().color().name(), item.symbol().color().alpha()] for item in items]
    return {"legend": legend, "features": layer.featureCount(), "drawn": drawn(layer)}


def drawn(layer):
    """How many features each entry of the legend draws; under "nothing" those that none draws."""
    renderer, context = layer.renderer(), QgsRenderContext()
    context.expressionContext().appendScopes(QgsExpressionContextUtils.globalProjectLayerScopes(layer))
    renderer.startRender(context, layer.fields())
    labels = {item.ruleKey(): item.label() for item in renderer.legendSymbolItems()}
    counts = {}
    for feature in layer.getFeatures():
        context.expressionContext().setFeature(feature)
        keys = renderer.legendKeysForFeature(feature, context) if renderer.willRenderFeature(feature, context) else ()
        label = next((labels[key] for key in keys), "nothing")
        counts[label] = counts.get(label, 0) + 1
    renderer.stopRender(context)
    return counts


def corners(box):
    return [box.xMinimum(), box.yMinimum(), box.xMaximum(), box.yMaximum()]


def leaves(group):
    """The tree of layers: group, title, id, whether it is shown and whether the layer was found."""
    found = []
    for child in group.children():
        if hasattr(child, "layerId"):
            found.append([group.name(), child.name(), child.layerId(), child.isVisible(), child.layer() is not None])
        else:
            found += leaves(child)
    return found


def colours_of(layers, extent, crs):
    """Draw layers, the topmost first, and return the number of colours."""
    settings = QgsMapSettings()
    settings.setLayers(layers)
    settings.setDestinationCrs(crs)
    settings.setBackgroundColor(QColor("white"))
    settings.setOutputSize(QSize(*SIZE))
    settings.setExtent(extent)
    job = QgsMapRendererParallelJob(settings)
    job.start()
    job.waitForFinished()
    image = job.renderedImage()
    return len({image.pixel(x, y) for x in range(0, SIZE[0], 4) for y in range(0, SIZE[1], 4)})


def describe_project(path):
    """What opens with a project; its view as the main window takes it."""
    project, canvas = QgsProject.instance(), QgsMapCanvas()
    canvas.setObjectName("theMapCanvas")
    canvas.resize(*SIZE)
    project.readProject.connect(canvas.readProject)
    found = {"read": project.read(str(path)), "error": project.error()}
    tree = project.layerTreeRoot()
    shown = [node.layer() for node in tree.findLayers() if node.isVisible()]
    return found | {
        "title": project.title(),
        "abstract": project.metadata().abstract(),
        "crs": project.crs().authid(),
        "crs_valid": project.crs().isValid(),
        "tree": leaves(tree),
        "layers": {layer.id(): describe(layer) for layer in project.mapLayers().values()},
        "extent": corners(canvas.extent()),
        "colours": colours_of(shown, canvas.extent(), project.crs()),
    }


def main(folder, report):
    application = QgsApplication([], True)
    application.initQgis()
    found = {"qgis": Qgis.QGIS_VERSION, "layers": {}}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        make = QgsRasterLayer if path.suffix in {".tif", ".vrt"} else QgsVectorLayer
        if path.suffix in {".tif", ".vrt", ".geojson", ".fgb", ".gpkg"}:
            layer = make(str(path), path.stem)
            found["layers"][name] = describe(layer)
            if layer.isValid():
                found["layers"][name]["colours"] = colours_of([layer], layer.extent(), layer.crs())
    if (folder / "map.qgs").exists():
        found["project"] = describe_project(folder / "map.qgs")
    report.write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
