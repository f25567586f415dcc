"""The texture network as ONNX.

The graph has no operator whose result for a patch depends on its position in the batch (the last two layers are 1 x 1
convolutions, not matrix products over the batch).
"""

from collections.abc import Mapping
from string import ascii_lowercase

from bumpymap.lab.train.model import TextureNet
from bumpymap.lab.train.onnx_graph import OnnxGraph

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
    graph = OnnxGraph("texture", ascii_lowercase.__getitem__)

    def layer(number: int, source: str) -> str:
        conv, norm = getattr(net, f"conv{number}"), getattr(net, f"norm{number}")
        return graph.add("Relu", [graph.conv(conv, norm, source, f"conv{number}")])

    x = layer(2, layer(1, INPUT_NAME))
    x = graph.add("MaxPool", [x], kernel_shape=[3, 3], strides=[2, 2])
    x = layer(4, layer(3, x))
    x = layer(5, graph.add("GlobalAveragePool", [x]))
    x = graph.add("Flatten", [graph.conv(net.head, None, x, "head")], axis=1)
    graph.add("Softmax", [x], OUTPUT_NAME, axis=1)
    pixels, classes = net.settings.pixels, len(net.settings.classes)
    return graph.to_bytes({INPUT_NAME: (1, pixels, pixels)}, (OUTPUT_NAME, classes), metadata)
