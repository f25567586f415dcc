"""Train networks (seeded, on the CPU, resumable from the last epoch) and write them: ONNX with reproducible bytes."""

import json
import logging
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from bumpymap.core import OutputError, UsageError, atomic, locked
from bumpymap.lab.label_sets import Accuracy
from bumpymap.lab.settings import LoopSettings

_log = logging.getLogger(__name__)


def restore(checkpoint: Path, record: dict[str, Any], net: nn.Module, optimizer: torch.optim.Optimizer) -> int:
    """Load a checkpoint into a network and its optimizer; return the number of completed epochs.

    A checkpoint of another ``record``, the plain values that determine a training, is a UsageError.
    """
    remedy = "Delete it, or choose another --out"
    try:
        state = torch.load(checkpoint, map_location="cpu", weights_only=True)
        found, done = state["record"], int(state["epochs_done"])
    except Exception as error:  # torch raises many kinds of errors for other files
        raise UsageError(f"{checkpoint} cannot be read as a checkpoint: {error}. {remedy}") from error
    if found != record:
        different = ", ".join(f"{k} {found.get(k)} (now {v})" for k, v in record.items() if found.get(k) != v)
        raise UsageError(f"{checkpoint} belongs to a training with other settings: {different}. {remedy}")
    net.load_state_dict(state["network"])
    optimizer.load_state_dict(state["optimizer"])
    _log.info("continuing after epoch %d of %s", done, checkpoint)
    return done


Net = TypeVar("Net", bound=nn.Module)


@dataclass(frozen=True, slots=True)
class EpochReport:
    """Result of one epoch."""

    epoch: int
    """From 1."""
    epochs: int
    loss: float
    """Mean cross-entropy, nats."""
    accuracy: float
    """Accuracy on the training data of this epoch, during training."""
    seconds: float


@dataclass(frozen=True, slots=True)
class EpochData:
    """Training data of one epoch."""

    inputs: tuple[torch.Tensor, ...]
    """Arguments of the network, (n, ...) each."""
    labels: torch.Tensor
    """(n,) true classes."""
    bounds: list[int]
    """Start rows of the batches, and n."""


@dataclass(frozen=True, slots=True)
class Training(Generic[Net]):
    """A training; the same one gives the same bits on the same machine and libraries."""

    settings: LoopSettings
    make: Callable[[], Net]
    """Make the network with random weights."""
    epochs: Callable[[range], Iterator[EpochData]]
    """Yield the data of epochs by number; a resumed training gets the same data for the remaining epochs."""
    rate: Callable[[float], float]
    """Completed share of the training, 0..1 -> learning rate."""
    smoothing: float = 0.0
    """Label smoothing: share of each label that is spread over the other classes."""
    record: dict[str, Any] = field(default_factory=dict)
    """Plain values that affect the training in addition to its settings."""

    def run(self, checkpoint: Path | None = None, progress: Callable[[EpochReport], None] | None = None) -> Net:
        """Train the network and return it in evaluation mode.

        ``checkpoint`` is rewritten after every epoch, and training resumes from it if it exists; ``progress`` is called
        with a report after every epoch. Raises UsageError if the checkpoint belongs to a training with other settings,
        OutputError if it cannot be written.
        """
        threads = torch.get_num_threads()
        torch.set_num_threads(self.settings.threads)
        try:
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(self.settings.seed)
                net = self.make()
            optimizer = torch.optim.AdamW(net.parameters(), lr=0.0, weight_decay=self.settings.weight_decay)
            record = json.loads(json.dumps(asdict(self.settings) | self.record))  # lists, as a checkpoint returns them
            done = restore(checkpoint, record, net, optimizer) if checkpoint and checkpoint.exists() else 0
            for epoch, data in enumerate(self.epochs(range(done, self.settings.epochs)), done):
                report = self._run_epoch(net, optimizer, data, epoch)
                _log.info("epoch %d of %d: loss %.4f", report.epoch, report.epochs, report.loss)
                if checkpoint:
                    state = {"record": record, "epochs_done": epoch + 1, "network": net.state_dict()}
                    with atomic(checkpoint, (RuntimeError,)) as part:
                        torch.save({**state, "optimizer": optimizer.state_dict()}, part)
                if progress:
                    progress(report)
        finally:
            torch.set_num_threads(threads)
        return net.eval()

    def _run_epoch(self, net: Net, optimizer: torch.optim.Optimizer, data: EpochData, epoch: int) -> EpochReport:
        start = time.perf_counter()
        net.train()
        loss_sum, hits, count = 0.0, 0, len(data.labels)
        batches = len(data.bounds) - 1
        for number in range(batches):
            rows = slice(data.bounds[number], data.bounds[number + 1])
            rate = self.rate((epoch + number / batches) / self.settings.epochs)
            for group in optimizer.param_groups:
                group["lr"] = rate
            labels = data.labels[rows]
            logits = net(*(values[rows] for values in data.inputs))
            loss = nn.functional.cross_entropy(logits, labels, label_smoothing=self.smoothing)
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            loss_sum += loss.item() * len(logits)
            hits += int((logits.argmax(1) == labels).sum())
        seconds = time.perf_counter() - start
        return EpochReport(epoch + 1, self.settings.epochs, loss_sum / count, hits / count, seconds)


Scores = TypeVar("Scores")


@dataclass(frozen=True, slots=True)
class TrainedModel(Generic[Scores]):
    """The files of a trained model and its scores."""

    model: Path
    card: Path
    evaluation: Scores
    parameters: int
    """Number of trained parameters."""


@dataclass(frozen=True, slots=True)
class ModelFiles:
    """Paths of the files of one training."""

    model: Path
    """The ONNX file."""

    @property
    def card(self) -> Path:
        """The model card, in Markdown."""
        return self.model.with_suffix(".md")

    @property
    def checkpoint(self) -> Path:
        """The file from which an interrupted training resumes."""
        return self.model.with_name(self.model.name + ".checkpoint")

    def write(self, content: bytes, card: str) -> None:
        """Write network and card; delete the checkpoint."""
        with atomic(self.model) as beside:
            beside.write_bytes(content)
        with atomic(self.card) as beside:
            beside.write_text(card, encoding="utf-8")
        self.checkpoint.unlink(missing_ok=True)


@contextmanager
def model_files(out: Path) -> Iterator[ModelFiles]:
    """Lock the output folder against a second training of the same network, or raise OutputError."""
    if not (out.parent.is_dir() and os.access(out.parent, os.W_OK)):
        raise OutputError(f"cannot write {out}: {out.parent} is not a writable folder. Choose another --out")
    with locked(out.parent, f".{out.name}.lock"):
        yield ModelFiles(out)


def parameter_count(net: nn.Module) -> int:
    """Return the number of trained parameters of a network."""
    return sum(p.numel() for p in net.parameters())


def versions(kind: str) -> dict[str, object]:
    """Return format and versions for the metadata of an ONNX file."""
    return {"format": kind, "bumpymap": version("bumpymap"), "torch": torch.__version__}


def percent(share: float) -> str:
    """Format a share of 0..1 as per cent, for a model card."""
    return f"{100 * share:.2f} %"


def score_table(score: Accuracy, names: Sequence[str]) -> str:
    """Return the confusion matrix as a Markdown table; ``names`` of the classes, in order."""
    head = ["| true \\ predicted | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    lines = zip(names, score.confusion, strict=True)
    return "\n".join([*head, *(f"| {name} | " + " | ".join(map(str, line)) + " |" for name, line in lines)])


_OPSET, _IR_VERSION = 17, 8
"""Versions of the operators and of the format of ONNX: old ones, for old versions of ONNX Runtime."""


class OnnxGraph:
    """Nodes and weights in the order in which they are added; each method returns the name of its output.

    Batch normalisation is folded into the convolutions.
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

        ``inputs``: name -> shape of one sample; ``output``: name of the output with the probabilities, and number of
        classes; ``metadata``: written as ``metadata_props``, text as it is, everything else as JSON.
        """
        infos = [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", *shape])
            for name, shape in (*inputs.items(), (output[0], [output[1]]))
        ]
        graph = helper.make_graph(self._nodes, self._name, infos[:-1], infos[-1:], self._weights)
        model = helper.make_model(
            graph, producer_name="bumpymap", opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR_VERSION
        )
        helper.set_model_props(model, {k: v if isinstance(v, str) else json.dumps(v) for k, v in metadata.items()})
        onnx.checker.check_model(model, full_check=True)
        content: bytes = model.SerializeToString(deterministic=True)
        return content


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
