"""The scan network as ONNX, written out layer by layer: normalisation folded into convolutions, softmax at the end.

Operators are those of opset 17. The graph holds none whose answer for one sector depends on its place in the batch.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from bumpymap.core import CLASSES, PolarSettings
from bumpymap.lab.train.onnx_graph import as_double, fold, to_bytes
from bumpymap.lab.train.scan.model import ScanNet
from bumpymap.scan import CHANNELS, MEASURES

__all__ = ["to_onnx"]


class _Graph:
    """Nodes and weights in the order in which they are added; each method returns the name of its output."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.weights: list[onnx.TensorProto] = [
            self.constant("zero", np.float32(0.0)),
            self.constant("six", np.float32(6.0)),
            self.constant("plane", np.array([2, 3], np.int64)),
        ]

    @staticmethod
    def constant(name: str, value: NDArray[np.generic] | np.generic) -> onnx.TensorProto:
        """Make a stored value."""
        return numpy_helper.from_array(np.asarray(value), name)

    def add(self, kind: str, inputs: list[str], **attributes: object) -> str:
        """Add one operator."""
        name = f"x{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [name], **attributes))
        return name

    def conv(self, layer: nn.Conv2d, norm: nn.BatchNorm2d | None, source: str) -> str:
        """Add a convolution; ``norm`` is folded in."""
        if norm is not None:
            weight, bias = fold(layer, norm)
        else:
            weight, bias = (as_double(part).astype(np.float32) for part in (layer.weight, layer.bias))
        name = f"conv{len(self.nodes)}"
        self.weights.append(self.constant(f"{name}.weight", weight))
        self.weights.append(self.constant(f"{name}.bias", bias))
        return self.add(
            "Conv",
            [source, f"{name}.weight", f"{name}.bias"],
            pads=[layer.padding[0]] * 4,
            strides=[layer.stride[0]] * 2,
            group=layer.groups,
        )

    def normalised(self, pair: Any, source: str, *, bent: bool) -> str:
        """Add a convolution with its normalisation, and relu6 where it is ``bent``."""
        layer, norm = pair.children()
        if not isinstance(layer, nn.Conv2d) or not isinstance(norm, nn.BatchNorm2d):
            raise TypeError(f"expected a convolution and its normalisation, not {pair}")
        out = self.conv(layer, norm, source)
        return self.add("Clip", [out, "zero", "six"]) if bent else out


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
    pixels = PolarSettings().pixels
    built = _build(net)
    graph = helper.make_graph(
        built.nodes,
        "scan",
        [
            helper.make_tensor_value_info("patches", TensorProto.FLOAT, ["batch", CHANNELS, pixels, pixels]),
            helper.make_tensor_value_info("measures", TensorProto.FLOAT, ["batch", len(MEASURES)]),
        ],
        [helper.make_tensor_value_info("probability", TensorProto.FLOAT, ["batch", CLASSES])],
        built.weights,
    )
    return to_bytes(graph, metadata)


def _build(net: ScanNet) -> _Graph:
    graph = _Graph()
    x = graph.normalised(net.stem, "patches", bent=True)
    for block in net.blocks:
        inner = graph.normalised(block.widen, x, bent=True)
        inner = graph.normalised(block.filter, inner, bent=True)
        narrow = graph.normalised(block.narrow, inner, bent=False)
        x = graph.add("Add", [x, narrow]) if block.adds else narrow
    x = graph.add("GlobalAveragePool", [x])
    beside = graph.normalised(net.beside, graph.add("Unsqueeze", ["measures", "plane"]), bent=True)
    x = graph.normalised(net.hidden, graph.add("Concat", [x, beside], axis=1), bent=True)
    x = graph.add("Flatten", [graph.conv(net.head, None, x)], axis=1)
    graph.nodes.append(helper.make_node("Softmax", [x], ["probability"], axis=1))
    return graph
