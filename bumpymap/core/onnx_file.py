"""Read, check and run the ONNX files of bumpymap's networks. The only module that imports ONNX Runtime.

Builds of ONNX Runtime send telemetry from import on: they store a machine identifier and a database of events in the
user's cache and start a network thread. Telemetry is switched off before the import.
"""

import math
import os
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core.errors import BadInputError
from bumpymap.core.files import read_regular

_MOST_NODES = 1000
_MOST_VALUES = 1 << 28
"""Values of the outputs of all nodes at most, with the windows that a convolution takes from one image."""
_MOST_PRODUCTS = 10**11
"""Multiplications for a batch at most, about ten seconds."""
_SAME = frozenset(("BatchNormalization", "Clip", "Elu", "HardSigmoid", "HardSwish", "Identity", "LeakyRelu"))
_SAME |= {"Relu", "Sigmoid", "Softmax", "Tanh"}
"""Operators whose output has the shape of their first input."""
_BROADCAST = frozenset(("Add", "Div", "Mul", "Sub"))
_POOLS = frozenset(("AveragePool", "MaxPool"))
_OTHERS = frozenset(("Concat", "Conv", "Flatten", "GlobalAveragePool", "Unsqueeze"))
_ATTRIBUTES = frozenset(
    ("alpha", "axis", "beta", "dilations", "epsilon", "group", "kernel_shape", "momentum", "pads", "strides")
)
_KNOWN = {
    "model": (1, 2, 3, 4, 5, 6, 7, 8, 14),
    "graph": (1, 2, 5, 10, 11, 12, 13, 16),
    "node": (1, 2, 3, 4, 5, 6, 7, 9),
    "attribute": (1, 2, 3, 4, 7, 8, 9, 13, 20),
    "tensor": (1, 2, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14),
    "property": (1, 2),
}
"""Numbers of the fields that are read or do no harm: no tensors or graphs in attributes, sparse tensors, functions or
training."""
_INT64 = 7

Shape = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class _NetworkNode:
    kind: str
    inputs: tuple[str, ...]
    output: str
    attributes: Mapping[str, tuple[int, ...]]
    """Those that are whole numbers."""


@dataclass(frozen=True, slots=True)
class NetworkGraph:
    """The graph of a network that holds nothing but known operators."""

    metadata: dict[str, str]
    """The file's ``metadata_props``."""
    nodes: tuple[_NetworkNode, ...]
    weights: Mapping[str, Shape]
    axes: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    """Values of small weights that are whole numbers."""

    def require_bounded(self, inputs: Mapping[str, Shape]) -> None:
        """Raise ValueError if the network would allocate or compute too much for inputs of these shapes."""
        shapes, values, products = {**self.weights, **inputs}, 0, 0
        for node in self.nodes:
            if unknown := [name for name in node.inputs if name and name not in shapes]:
                raise ValueError(f"{node.kind} takes {unknown[0]!r}, which nothing gives")
            if node.output in shapes:
                raise ValueError(f"{node.output!r} is given twice")
            given = [shapes[name] for name in node.inputs if name]
            try:
                shape = shapes[node.output] = self._shape(node, given)
                taken = math.prod(given[1][1:]) if node.kind == "Conv" else 1
            except (IndexError, KeyError, TypeError, ValueError) as error:
                raise ValueError(f"the shapes of {node.kind} do not fit: {given}") from error
            if min(shape, default=1) < 1:
                raise ValueError(f"{node.kind} would give an empty array, of shape {shape}")
            values += max(math.prod(shape), taken * math.prod(shape[2:]))
            products += taken * math.prod(shape)
            if values > _MOST_VALUES or products > _MOST_PRODUCTS:
                raise ValueError(
                    f"{node.kind} would give an array of shape {shape}: with a batch of tiles or sectors, the network "
                    f"takes more than {_MOST_VALUES * 4 >> 20} MB or {_MOST_PRODUCTS:,} multiplications"
                )

    def _shape(self, node: _NetworkNode, given: Sequence[Shape]) -> Shape:
        """Return the shape of the output of a node."""
        first, axis = given[0], node.attributes.get("axis", (1,))[0]
        shape: Sequence[int] = first
        if node.kind in _BROADCAST:
            shape = np.broadcast_shapes(*given)
        elif node.kind == "Conv":
            shape = (first[0], given[1][0], *_windows(node, first[2:], given[1][2:]))
        elif node.kind in _POOLS:
            shape = (*first[:2], *_windows(node, first[2:], node.attributes["kernel_shape"]))
        elif node.kind == "GlobalAveragePool":
            shape = (*first[:2], *(1 for _ in first[2:]))
        elif node.kind == "Flatten":
            shape = (math.prod(first[:axis]), math.prod(first[axis:]))
        elif node.kind == "Concat":
            shape = (*first[:axis], sum(own[axis] for own in given), *first[axis:][1:])
        elif node.kind == "Unsqueeze":
            shape = list(first)
            for place in sorted(self.axes[node.inputs[1]]):
                shape.insert(place, 1)
        return tuple(shape)


def _windows(node: _NetworkNode, sizes: Shape, kernel: Sequence[int]) -> list[int]:
    """Return how many windows a convolution or a pool takes along each axis."""
    count = len(sizes)
    strides, dilations = (node.attributes.get(name, (1,) * count) for name in ("strides", "dilations"))
    pads = node.attributes.get("pads", (0,) * (2 * count))
    if min(*strides, *dilations, *kernel) < 1 or min(pads) < 0:
        raise ValueError("a stride below 1")
    return [
        (sizes[i] + pads[i] + pads[count + i] - dilations[i] * (kernel[i] - 1) - 1) // strides[i] + 1
        for i in range(count)
    ]


def read_graph(content: bytes) -> NetworkGraph:
    """Read the graph of an ONNX file. Raises ValueError if it holds what no network of bumpymap needs."""
    model = _fields(content, "model")
    graph = _fields(_bytes(_one(model, 7)), "graph")
    metadata: dict[str, str] = {}
    for entry in model.get(14, []):
        found = _fields(_bytes(entry), "property")
        metadata[_text(found, 1)] = _text(found, 2)
    nodes = graph.get(1, [])
    if len(nodes) > _MOST_NODES:
        raise ValueError(f"it has {len(nodes):,} nodes; at most {_MOST_NODES:,} are run")
    weights: dict[str, Shape] = {}
    axes: dict[str, tuple[int, ...]] = {}
    for tensor in graph.get(5, []):
        _read_weight(_bytes(tensor), weights, axes)
    return NetworkGraph(metadata, tuple(_read_node(_bytes(node)) for node in nodes), weights, axes)


def _read_node(content: bytes) -> _NetworkNode:
    found = _fields(content, "node")
    kind = _text(found, 4)
    if _text(found, 7) not in {"", "ai.onnx"} or kind not in _SAME | _BROADCAST | _POOLS | _OTHERS:
        raise ValueError(f"it uses the operator {kind!r}, which no network of bumpymap has")
    attributes = {}
    for entry in found.get(5, []):
        own = _fields(_bytes(entry), "attribute")
        name = _text(own, 1)
        if name not in _ATTRIBUTES or name in attributes:
            raise ValueError(f"{kind} has the attribute {name!r}, which no network of bumpymap has")
        attributes[name] = tuple(_integers(own.get(3, []) + own.get(8, [])))
    inputs = tuple(_bytes(name).decode() for name in found.get(1, []))
    return _NetworkNode(kind, inputs, _text(found, 2), {name: values for name, values in attributes.items() if values})


def _read_weight(content: bytes, weights: dict[str, Shape], axes: dict[str, tuple[int, ...]]) -> None:
    found = _fields(content, "tensor")
    name = _text(found, 8)
    if found.get(13) or any(found.get(14, [])):
        raise ValueError(f"the values of {name!r} are in another file (external data). Save the network as one file")
    shape = tuple(_integers(found.get(1, [])))
    if name in weights or min(shape, default=1) < 1 or math.prod(shape) > len(content):
        raise ValueError(f"the weight {name!r} has the shape {shape}, which is not that of its values")
    weights[name] = shape
    if found.get(2) == [_INT64] and math.prod(shape) <= len(shape or (1,)) * 8:
        raw = b"".join(map(_bytes, found.get(9, [])))
        axes[name] = struct.unpack(f"<{len(raw) // 8}q", raw) if raw else tuple(_integers(found.get(7, [])))


def _fields(data: bytes, message: str) -> dict[int, list[int | bytes]]:
    """Return the fields of a message of Protocol Buffers by their numbers; refuse those that are not known."""
    found: dict[int, list[int | bytes]] = {}
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        number, kind = key >> 3, key & 7
        if number not in _KNOWN[message]:
            raise ValueError(f"its {message} holds field {number}, which no network of bumpymap has")
        value: int | bytes
        if kind == 0:
            value, at = _varint(data, at)
        elif kind in {1, 2, 5}:
            size, at = _varint(data, at) if kind == 2 else ({1: 8, 5: 4}[kind], at)
            value, at = data[at : at + size], at + size
        else:
            raise ValueError(f"its {message} is damaged at byte {at}")
        if at > len(data):
            raise ValueError(f"its {message} is cut off")
        found.setdefault(number, []).append(value)
    return found


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Return the whole number of variable length at a place, as signed 64 bits, and the place after it."""
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            raise ValueError("it is cut off")
        value |= (data[at] & 127) << shift
        at += 1
        if data[at - 1] < 128:
            value &= (1 << 64) - 1
            return value - (1 << 64 if value >> 63 else 0), at
    raise ValueError(f"it is damaged at byte {at}")


def _integers(values: Sequence[int | bytes]) -> list[int]:
    """Return whole numbers that are stored one by one or packed."""
    found: list[int] = []
    for value in values:
        if isinstance(value, int):
            found.append(value)
            continue
        at = 0
        while at < len(value):
            one, at = _varint(value, at)
            found.append(one)
    return found


def _one(found: Mapping[int, list[int | bytes]], number: int) -> int | bytes:
    """Return the value of a field that is there once, or empty bytes; readers merge or drop repeated ones."""
    values = found.get(number, [b""])
    if len(values) > 1:
        raise ValueError(f"a field {number} is repeated")
    return values[0]


def _bytes(value: int | bytes) -> bytes:
    if isinstance(value, int):
        raise ValueError("a number stands for a text")  # noqa: TRY004 (the content of a file)
    return value


def _text(found: Mapping[int, list[int | bytes]], number: int) -> str:
    return _bytes(_one(found, number)).decode()


_MOST_BYTES = 64 << 20
"""Size of the file of a network; the included ones have 0.4 MB."""


def onnx_runtime() -> Any:
    """Import ONNX Runtime with telemetry and terminal output switched off."""
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"  # read once, when the library is loaded
    import onnxruntime

    onnxruntime.disable_telemetry_events()  # the switch of builds for Windows
    onnxruntime.set_default_logger_severity(3)
    return onnxruntime


@lru_cache(maxsize=4)
def session(content: bytes) -> Any:
    """Open a network for inference on one thread; the last four stay open."""
    runtime = onnx_runtime()
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    options.add_session_config_entry("session.load_model_format", "ONNX")  # what was checked, whatever its first bytes
    return runtime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


@lru_cache(maxsize=2)
def shipped_network(room: str, name: str) -> bytes:
    """Read a network that ships with a package of bumpymap: ``shipped_network("rating", "textures.onnx")``."""
    return (files(f"bumpymap.{room}") / "data" / "models" / name).read_bytes()


def read_network(path: Path, kind: str, remedy: str) -> bytes:
    """Read the file of a network.

    Parameters
    ----------
    path : Path
    kind : str
        Kind of network, for messages: ``texture network``.
    remedy : str
        Advice for messages.

    Raises
    ------
    BadInputError
        The file cannot be read, or is too large.
    """
    try:
        return read_regular(path, _MOST_BYTES)
    except OSError as error:
        raise BadInputError(f"cannot read the {kind} {path}: {error.strerror}. {remedy}") from error


def metadata_of(content: bytes, format_name: str, origin: str, kind: str, remedy: str) -> dict[str, str]:
    """Return the ``metadata_props`` of a network.

    Parameters
    ----------
    content : bytes
        The ONNX file.
    format_name : str
        Required value of its property ``format``.
    origin : str
        Source of the file, for messages.
    kind, remedy : str
        As for ``read_network``.

    Raises
    ------
    BadInputError
        The file is not an ONNX file, not a network of bumpymap, or refused by `read_graph`.
    """
    try:
        metadata = read_graph(content).metadata
    except ValueError as error:
        raise BadInputError(f"{origin} is not an ONNX model that bumpymap runs: {error}. {remedy}") from error
    if metadata.get("format") != format_name:
        raise BadInputError(f"{origin} is an ONNX model, but not a {kind} of bumpymap. {remedy}")
    return metadata


def check_network(
    content: bytes, inputs: Mapping[str, tuple[int, ...]], classes: int, origin: str, remedy: str
) -> None:
    """Run a network once, if it needs little memory and time for it.

    Parameters
    ----------
    content : bytes
        The ONNX file, see `metadata_of`.
    inputs : mapping
        Name of each input -> its shape, of a batch.
    classes : int
        The output has this many columns.
    origin, remedy : str
        As for ``metadata_of``.

    Raises
    ------
    BadInputError
        It needs too much, or cannot be run, or gives something else.
    """
    try:
        read_graph(content).require_bounded(inputs)
        found = session(content).run(None, {name: np.zeros(shape, np.float32) for name, shape in inputs.items()})[0]
        expected = (next(iter(inputs.values()))[0], classes)
        if found.shape != expected or found.dtype != np.float32:
            raise ValueError(f"it gives {found.dtype} of shape {found.shape}, and not float32 of {expected}")  # noqa: TRY301
    except Exception as error:  # ONNX Runtime's exceptions have no public base
        raise BadInputError(f"{origin} is not an ONNX model that bumpymap runs: {error}. {remedy}") from error
