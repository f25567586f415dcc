"""Load layers and a project as QGIS does when a user drags them in, and report what came of it as JSON.

/usr/bin/python3 load_in_qgis.py FOLDER REPORT.json
"""

import json
import os
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

os.environ["QT_QPA_PLATFORM"] = "offscreen"

from qgis import core
from qgis.core import (
    QgsApplication,
    QgsExpression,
    QgsExpressionContext,
    QgsExpressionContextScope,
    QgsExpressionContextUtils,
    QgsGeometry,
    QgsLayerTreeModel,
    QgsLayoutExporter,
    QgsMapRendererParallelJob,
    QgsMapSettings,
    QgsPointXY,
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
KINDS = {
    kind.lower(): getattr(core, f"QgsLayoutItem{kind}") for kind in ("Map", "Legend", "ScaleBar", "Picture", "Label")
}


def describe(layer):
    """Renderer, CRS, extent, blending and legend of a layer; how many features each entry of the legend draws."""
    found = {"name": layer.name(), "valid": layer.isValid()}
    if not layer.isValid():
        return found | {"error": layer.error().summary()}
    renderer, crs = layer.renderer(), layer.crs()
    found |= {"source": layer.source(), "crs": crs.authid(), "crs_valid": crs.isValid(), "renderer": renderer.type()}
    found |= {"extent": corners(layer.extent()), "hard_light": layer.blendMode() == 20}  # CompositionMode_HardLight
    if not isinstance(layer, QgsRasterLayer):
        items = renderer.legendSymbolItems()  # which own their symbols
        colours = [item.symbol().color() for item in items]
        found["legend"] = [[item.label(), one.name(), one.alpha()] for item, one in zip(items, colours, strict=True)]
        found["unnamed"] = [field.name() for field in layer.fields() if not field.alias()]
        found["tips"] = tips(layer, layer.mapTipTemplate())
        return found | {"features": layer.featureCount(), "drawn": drawn(layer)}
    items = renderer.legendSymbologyItems()
    found |= {"bands": renderer.usesBands(), "legend": [[name, one.name(), one.alpha()] for name, one in items]}
    if renderer.type() == "paletted":
        found["values"] = [int(entry.value) for entry in renderer.classes()]
    elif renderer.type() == "singlebandpseudocolor":
        found["values"] = [item.value for item in renderer.shader().rasterShaderFunction().colorRampItemList()]
    return found


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
        for label in [labels[key] for key in keys if key in labels] or ["nothing"]:
            counts[label] = counts.get(label, 0) + 1
    renderer.stopRender(context)
    return counts


def tips(layer, template):
    """What map tips say of up to a hundred features, or of places on a raster, which QGIS shows from 3.32 on."""
    context, said = QgsExpressionContext(QgsExpressionContextUtils.globalProjectLayerScopes(layer)), {}
    if isinstance(layer, QgsVectorLayer):
        context.setFields(layer.fields())
        for feature, _ in zip(layer.getFeatures(), range(100), strict=False):
            context.setFeature(feature)
            said[QgsExpression.replaceExpressionText(template, context)] = None
        return [*said]
    box, scope = layer.extent(), QgsExpressionContextScope()
    context.appendScope(scope)
    for number in range(100):
        x = box.xMinimum() + (number % 10 + 0.5) / 10 * box.width()
        y = box.yMinimum() + (number // 10 + 0.5) / 10 * box.height()
        scope.setVariable("layer_cursor_point", QgsGeometry.fromPointXY(QgsPointXY(x, y)))
        said[QgsExpression.replaceExpressionText(template, context)] = None
    return [*said]


def corners(box):
    return [box.xMinimum(), box.yMinimum(), box.xMaximum(), box.yMaximum()]


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
    pages = [describe_page(page) for page in project.layoutManager().printLayouts()]
    maps = ET.parse(path)  # noqa: S314 (our own file)
    model, layers = QgsLayerTreeModel(tree), project.mapLayers()
    rows = [row.data(0) for node in tree.findLayers() for row in model.layerLegendNodes(node)]
    said = {one.find("id").text: one.find("mapTip").text for one in maps.iter("maplayer")}
    shown = [node.layer() for node in tree.findLayers() if node.isVisible()]
    return found | {
        "title": project.title(),
        "abstract": project.metadata().abstract(),
        "crs": project.crs().authid(),
        "crs_valid": project.crs().isValid(),
        "tree": [[node.layerId(), node.isVisible(), node.layer() is not None] for node in tree.findLayers()],
        "layers": {name: describe(one) | {"tips": tips(one, said[name])} for name, one in layers.items()},
        "rows": [row for row in rows if isinstance(row, str)],
        "extent": corners(canvas.extent()),
        "colours": colours_of(shown, canvas.extent(), project.crs()),
        "pages": pages,
    }


def describe_page(layout):
    """What a page to print holds: its items by kind, texts as drawn, scale, legend, how many colours it is drawn in."""
    kinds = {name: [item for item in layout.items() if isinstance(item, kind)] for name, kind in KINDS.items()}
    image = QgsLayoutExporter(layout).renderPageToImage(0, dpi=60)
    tree = kinds["legend"][0].model()
    layers = tree.rootGroup().findLayers()
    titles = [tree.data(tree.node2index(layer), 0) for layer in layers]
    entries = [node.data(0) or "" for layer in layers for node in tree.layerLegendNodes(layer)]
    return {
        "items": [len(found) for found in kinds.values()],
        "texts": [*(item.currentText() for item in kinds["label"]), *titles, *filter(None, map(str, entries))],
        "scale": kinds["map"][0].scale(),
        "legend": [layer.layerId() for layer in layers],
        "colours": len({image.pixel(x, y) for x in range(0, image.width(), 4) for y in range(0, image.height(), 4)}),
    }


def main(folder, report):
    application = QgsApplication([], True)
    application.initQgis()
    found = {"layers": {}}
    for path in sorted(folder.rglob("*")):
        if path.suffix in {".tif", ".geojson", ".fgb", ".gpkg"}:
            layer = (QgsRasterLayer if path.suffix == ".tif" else QgsVectorLayer)(str(path), path.stem)
            about = found["layers"][path.relative_to(folder).as_posix()] = describe(layer)
            if layer.isValid():
                about["colours"] = colours_of([layer], layer.extent(), layer.crs())
    if (folder / "map.qgs").exists():
        found["project"] = describe_project(folder / "map.qgs")
    report.write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
