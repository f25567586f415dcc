"""What the ONNX files of our networks share: folded convolutions, versions, properties, the same bytes each time."""

import json
from collections.abc import Mapping

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import helper
from torch import nn

__all__ = ["as_double", "fold", "to_bytes"]

_OPSET = 17
_IR_VERSION = 8
_Doubles = NDArray[np.float64]


def as_double(tensor: torch.Tensor | None) -> _Doubles:
    """Return the numbers of a layer. Raises TypeError where it has none."""
    if tensor is None:
        raise TypeError("a layer of the network lacks its weights")
    values: _Doubles = tensor.detach().double().numpy()
    return values


def fold(conv: nn.Conv2d, norm: nn.BatchNorm2d) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Weight and bias of one convolution equal to ``norm(conv(x))``: w g / s and b - m g / s, s = sqrt(var + eps)."""
    gain = as_double(norm.weight) / np.sqrt(as_double(norm.running_var) + norm.eps)
    weight = as_double(conv.weight) * gain[:, None, None, None]
    bias = as_double(norm.bias) - as_double(norm.running_mean) * gain
    return weight.astype(np.float32), bias.astype(np.float32)


def to_bytes(graph: onnx.GraphProto, metadata: Mapping[str, object]) -> bytes:
    """Check a graph and write it as a file; ``metadata``: text as it is, everything else as JSON."""
    model = helper.make_model(
        graph, producer_name="bumpymap", opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR_VERSION
    )
    helper.set_model_props(model, {k: v if isinstance(v, str) else json.dumps(v) for k, v in metadata.items()})
    onnx.checker.check_model(model, full_check=True)
    content: bytes = model.SerializeToString(deterministic=True)
    return content
