"""Network to ONNX, written out layer by layer: batch normalisation folded into the convolutions, softmax at the end.

Operators are those of opset 17, so that old ONNX Runtimes read the file. The graph holds no operator whose answer for
one patch depends on its place in the batch (the last two layers are 1 x 1 convolutions, not matrix products over the
batch).
"""

from collections.abc import Mapping

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from bumpymap.lab.train.model import TextureNet
from bumpymap.lab.train.onnx_graph import as_double, fold, to_bytes

__all__ = ["INPUT_NAME", "OUTPUT_NAME", "to_onnx"]

INPUT_NAME = "patches"
OUTPUT_NAME = "probability"


def to_onnx(net: TextureNet, metadata: Mapping[str, object]) -> bytes:
    """Write a network as an ONNX file.

    Parameters
    ----------
    net : TextureNet
        In evaluation mode.
    metadata : mapping
        Written as ``metadata_props``: text as it is, everything else as JSON.

    Returns
    -------
    bytes
        Input ``patches`` (batch, 1, pixels, pixels) float32, output ``probability`` (batch, classes) float32.
    """
    weights = {
        "conv1": fold(net.conv1, net.norm1),
        "conv2": fold(net.conv2, net.norm2),
        "conv3": fold(net.conv3, net.norm3),
        "conv4": fold(net.conv4, net.norm4),
        "conv5": fold(net.conv5, net.norm5),
        "head": (as_double(net.head.weight).astype(np.float32), as_double(net.head.bias).astype(np.float32)),
    }
    pixels, classes = net.settings.pixels, len(net.settings.classes)
    graph = helper.make_graph(
        _nodes(int(net.conv4.padding[0])),
        "texture",
        [helper.make_tensor_value_info(INPUT_NAME, TensorProto.FLOAT, ["batch", 1, pixels, pixels])],
        [helper.make_tensor_value_info(OUTPUT_NAME, TensorProto.FLOAT, ["batch", classes])],
        [
            numpy_helper.from_array(array, f"{layer}.{part}")
            for layer, pair in weights.items()
            for part, array in zip(("weight", "bias"), pair, strict=True)
        ],
    )
    return to_bytes(graph, metadata)


def _nodes(border: int) -> list[onnx.NodeProto]:
    """Layers in order; ``border`` is the padding [px] of the fourth convolution."""

    def conv(layer: str, source: str, target: str, pad: int = 0) -> onnx.NodeProto:
        return helper.make_node("Conv", [source, f"{layer}.weight", f"{layer}.bias"], [target], pads=[pad] * 4)

    return [
        conv("conv1", INPUT_NAME, "a"),
        helper.make_node("Relu", ["a"], ["b"]),
        conv("conv2", "b", "c"),
        helper.make_node("Relu", ["c"], ["d"]),
        helper.make_node("MaxPool", ["d"], ["e"], kernel_shape=[3, 3], strides=[2, 2]),
        conv("conv3", "e", "f", pad=1),
        helper.make_node("Relu", ["f"], ["g"]),
        conv("conv4", "g", "h", pad=border),
        helper.make_node("Relu", ["h"], ["i"]),
        helper.make_node("GlobalAveragePool", ["i"], ["j"]),
        conv("conv5", "j", "k"),
        helper.make_node("Relu", ["k"], ["l"]),
        conv("head", "l", "m"),
        helper.make_node("Flatten", ["m"], ["n"], axis=1),
        helper.make_node("Softmax", ["n"], [OUTPUT_NAME], axis=1),
    ]
