"""Write networks as ONNX files layer by layer, with reproducible bytes."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from torch import nn

__all__ = ["OnnxGraph"]

_OPSET = 17
_IR_VERSION = 8


class OnnxGraph:
    """Nodes and weights in the order in which they are added; each method returns the name of its output.

    Batch normalisation is folded into the convolutions. Operators are those of opset 17, so that old versions of ONNX
    Runtime can read the file.
    """

    def __init__(self, name: str, output_name: Callable[[int], str]) -> None:
        """Start a graph; ``output_name`` returns the name of the output of the n-th node."""
        self._name, self._output_name = name, output_name
        self._nodes: list[onnx.NodeProto] = []
        self._weights: list[onnx.TensorProto] = []

    def constant(self, name: str, value: NDArray[np.generic] | np.generic) -> str:
        """Add a stored value."""
        self._weights.append(numpy_helper.from_array(np.asarray(value), name))
        return name

    def add(self, kind: str, inputs: Sequence[str], output: str | None = None, **attributes: Any) -> str:
        """Add one operator."""
        name = output or self._output_name(len(self._nodes))
        self._nodes.append(helper.make_node(kind, inputs, [name], **attributes))
        return name

    def conv(
        self, layer: nn.Conv2d, norm: nn.BatchNorm2d | None, source: str, name: str | None = None, **attributes: Any
    ) -> str:
        """Add a convolution with ``norm`` folded in. Its weights are named ``name``.weight and ``name``.bias."""
        name = name or f"conv{len(self._nodes)}"
        weight, bias = _folded_weights(layer, norm)
        inputs = [source, self.constant(f"{name}.weight", weight), self.constant(f"{name}.bias", bias)]
        return self.add("Conv", inputs, pads=[int(layer.padding[0])] * 4, **attributes)

    def to_bytes(
        self, inputs: Mapping[str, Sequence[int]], output: tuple[str, int], metadata: Mapping[str, object]
    ) -> bytes:
        """Check the graph and serialise it.

        Parameters
        ----------
        inputs : mapping
            Name -> shape of one sample.
        output : tuple
            Name of the output with the probabilities, and number of classes.
        metadata : mapping
            Written as ``metadata_props``: text as it is, everything else as JSON.
        """
        given = [_value_info(name, shape) for name, shape in inputs.items()]
        name, classes = output
        graph = helper.make_graph(self._nodes, self._name, given, [_value_info(name, [classes])], self._weights)
        model = helper.make_model(
            graph, producer_name="bumpymap", opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR_VERSION
        )
        helper.set_model_props(model, {k: v if isinstance(v, str) else json.dumps(v) for k, v in metadata.items()})
        onnx.checker.check_model(model, full_check=True)
        content: bytes = model.SerializeToString(deterministic=True)
        return content


def _value_info(name: str, shape: Sequence[int]) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", *shape])


def _folded_weights(conv: nn.Conv2d, norm: nn.BatchNorm2d | None) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Fold ``norm(conv(x))`` into one weight and bias: w g / s and b - m g / s, s = sqrt(var + eps)."""
    if norm is None:
        return _double(conv.weight).astype(np.float32), _double(conv.bias).astype(np.float32)
    gain = _double(norm.weight) / np.sqrt(_double(norm.running_var) + norm.eps)
    weight = _double(conv.weight) * gain[:, None, None, None]
    bias = _double(norm.bias) - _double(norm.running_mean) * gain
    return weight.astype(np.float32), bias.astype(np.float32)


def _double(tensor: torch.Tensor | None) -> NDArray[np.float64]:
    """Return a tensor as float64; raise TypeError for None."""
    if tensor is None:
        raise TypeError("a layer of the network lacks its weights")
    values: NDArray[np.float64] = tensor.detach().double().numpy()
    return values
