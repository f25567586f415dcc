"""Network to ONNX, written out layer by layer: batch normalisation folded into the convolutions, softmax at the end.

Operators are those of opset 17, so that old ONNX Runtimes read the file. The graph holds no operator whose answer for
one patch depends on its place in the batch (the last two layers are 1 x 1 convolutions, not matrix products over the
batch).
"""

import json
from collections.abc import Mapping

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from bumpymap.learn.model import TextureNet

__all__ = ["INPUT_NAME", "OUTPUT_NAME", "to_onnx"]

INPUT_NAME = "patches"
OUTPUT_NAME = "probability"
_OPSET = 17
_IR_VERSION = 8
_Weights = tuple[NDArray[np.float32], NDArray[np.float32]]


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
        "conv1": _fold(net.conv1, net.norm1),
        "conv2": _fold(net.conv2, net.norm2),
        "conv3": _fold(net.conv3, net.norm3),
        "conv4": _fold(net.conv4, net.norm4),
        "conv5": _fold(net.conv5, net.norm5),
        "head": (_numpy(net.head.weight), _numpy(net.head.bias)),
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
    model = helper.make_model(
        graph, producer_name="bumpymap", opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR_VERSION
    )
    props = {key: value if isinstance(value, str) else json.dumps(value) for key, value in metadata.items()}
    helper.set_model_props(model, props)
    onnx.checker.check_model(model, full_check=True)
    content: bytes = model.SerializeToString(deterministic=True)
    return content


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


def _fold(conv: nn.Conv2d, norm: nn.BatchNorm2d) -> _Weights:
    """Weight and bias of one convolution equal to ``norm(conv(x))``: w g / s and b - m g / s, s = sqrt(var + eps)."""
    gain = _numpy(norm.weight).astype(np.float64) / np.sqrt(_numpy(norm.running_var).astype(np.float64) + norm.eps)
    weight = _numpy(conv.weight) * gain[:, None, None, None]
    bias = _numpy(norm.bias) - _numpy(norm.running_mean) * gain
    return weight.astype(np.float32), bias.astype(np.float32)


def _numpy(tensor: torch.Tensor | None) -> NDArray[np.float32]:
    if tensor is None:
        raise TypeError("a layer of the network lacks its weights")
    values: NDArray[np.float32] = tensor.detach().numpy()
    return values
