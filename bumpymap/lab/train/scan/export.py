"""The scan network as ONNX. No operator's result for a sector depends on its position in the batch."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from torch import nn

from bumpymap.core import CLASSES, PolarSettings
from bumpymap.lab.train.onnx_graph import OnnxGraph
from bumpymap.lab.train.scan.model import ScanNet
from bumpymap.scan import CHANNELS, MEASURES

__all__ = ["to_onnx"]


def to_onnx(net: ScanNet, metadata: Mapping[str, object]) -> bytes:
    """Write a network as an ONNX file.

    Parameters
    ----------
    net : ScanNet
        In evaluation mode.
    metadata : mapping
        Written as ``metadata_props``: text as it is, everything else as JSON.

    Returns
    -------
    bytes
        Inputs ``patches`` (batch, CHANNELS, pixels, pixels) and ``measures`` (batch, len(MEASURES)), output
        ``probability`` (batch, CLASSES), all float32.
    """
    graph = OnnxGraph("scan", "x{}".format)
    ends = [graph.constant("zero", np.float32(0.0)), graph.constant("six", np.float32(6.0))]
    plane = graph.constant("plane", np.array([2, 3], np.int64))

    def relu6(pair: Any, source: str) -> str:
        return graph.add("Clip", [_convolution(graph, pair, source), *ends])

    x = relu6(net.stem, "patches")
    for block in net.blocks:
        narrow = _convolution(graph, block.narrow, relu6(block.filter, relu6(block.widen, x)))
        x = graph.add("Add", [x, narrow]) if block.adds else narrow
    x = graph.add("GlobalAveragePool", [x])
    joined = relu6(net.measures, graph.add("Unsqueeze", ["measures", plane]))
    x = relu6(net.hidden, graph.add("Concat", [x, joined], axis=1))
    x = graph.add("Flatten", [graph.conv(net.head, None, x, **_strides(net.head))], axis=1)
    graph.add("Softmax", [x], "probability", axis=1)
    pixels = PolarSettings().pixels
    inputs = {"patches": (CHANNELS, pixels, pixels), "measures": (len(MEASURES),)}
    return graph.to_bytes(inputs, ("probability", CLASSES), metadata)


def _convolution(graph: OnnxGraph, pair: Any, source: str) -> str:
    """Add a convolution with its normalisation."""
    layer, norm = pair.children()
    if not isinstance(layer, nn.Conv2d) or not isinstance(norm, nn.BatchNorm2d):
        raise TypeError(f"expected a convolution and its normalisation, not {pair}")
    return graph.conv(layer, norm, source, **_strides(layer))


def _strides(layer: nn.Conv2d) -> dict[str, Any]:
    return {"strides": [layer.stride[0]] * 2, "group": layer.groups}
