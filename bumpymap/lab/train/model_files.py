"""Train networks (seeded, on the CPU, resumable from the last epoch) and write them: ONNX with reproducible bytes."""

import json
import logging
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from bumpymap.core import OutputError, UsageError, atomic, locked
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


Epoch = tuple[tuple[torch.Tensor, ...], torch.Tensor, list[int]]
"""Training data of one epoch: arguments of the network, (n, ...) each; true classes (n,); start rows of the batches,
and n."""


def train_network(
    settings: LoopSettings,
    make: Callable[[], Net],
    epochs: Callable[[range], Iterator[Epoch]],
    rate: Callable[[float], float],
    record: dict[str, Any],
    checkpoint: Path | None = None,
    progress: Callable[[EpochReport], None] | None = None,
    *,
    smoothing: float = 0.0,
) -> Net:
    """Train a network and return it in evaluation mode; the same arguments give the same bits on the same machine.

    ``make``: makes the network with random weights; ``epochs``: yields the data of epochs by number, so that a resumed
    training gets the same data for the remaining ones; ``rate``: completed share of the training, 0..1 -> learning
    rate; ``record``: plain values that affect the training in addition to its settings; ``smoothing``: share of each
    label that is spread over the other classes.

    ``checkpoint`` is rewritten after every epoch, and training resumes from it if it exists; ``progress`` is called
    with a report after every epoch. Raises UsageError if the checkpoint belongs to a training with other settings,
    OutputError if it cannot be written.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(settings.threads)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(settings.seed)
            net = make()
        optimizer = torch.optim.AdamW(net.parameters(), lr=0.0, weight_decay=settings.weight_decay)
        record = json.loads(json.dumps(asdict(settings) | record))  # lists, as a checkpoint returns them
        done = restore(checkpoint, record, net, optimizer) if checkpoint and checkpoint.exists() else 0
        for epoch, data in enumerate(epochs(range(done, settings.epochs)), done):
            begin = time.perf_counter()
            batches = len(data[2]) - 1
            rates = [rate((epoch + number / batches) / settings.epochs) for number in range(batches)]
            loss, accuracy = _run_epoch(net, optimizer, data, rates, smoothing)
            report = EpochReport(epoch + 1, settings.epochs, loss, accuracy, time.perf_counter() - begin)
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


def _run_epoch(
    net: nn.Module, optimizer: torch.optim.Optimizer, data: Epoch, rates: list[float], smoothing: float
) -> tuple[float, float]:
    """Return mean loss and accuracy of an epoch; ``rates``: learning rate of each batch."""
    net.train()
    inputs, true, bounds = data
    loss_sum, hits = 0.0, 0
    for rate, *ends in zip(rates, bounds, bounds[1:], strict=False):
        rows = slice(*ends)
        for group in optimizer.param_groups:
            group["lr"] = rate
        labels = true[rows]
        logits = net(*(values[rows] for values in inputs))
        loss = nn.functional.cross_entropy(logits, labels, label_smoothing=smoothing)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        loss_sum += loss.item() * len(logits)
        hits += int((logits.argmax(1) == labels).sum())
    return loss_sum / len(true), hits / len(true)


_BATCH = 1024
"""Samples that a network predicts at once: memory."""


def predict(net: nn.Module, *inputs: torch.Tensor) -> NDArray[np.float32]:
    """Return the probabilities (n, classes) that a network computes for inputs (n, ...)."""
    with torch.no_grad():
        batches = zip(*(torch.split(values, _BATCH) for values in inputs), strict=True)
        parts = [net(*batch).softmax(1) for batch in batches]
    return torch.cat(parts).numpy()


@contextmanager
def training_files(out: Path) -> Iterator[Path]:
    """Lock the output folder against a second training of the same network, or raise OutputError.

    Yields the path of the checkpoint, from which an interrupted training resumes.
    """
    if not (out.parent.is_dir() and os.access(out.parent, os.W_OK)):
        raise OutputError(f"cannot write {out}: {out.parent} is not a writable folder. Choose another --out")
    with locked(out.parent, f".{out.name}.lock"):
        yield out.with_name(out.name + ".checkpoint")


def write_model(out: Path, content: bytes, checkpoint: Path) -> None:
    """Write an ONNX file; delete the checkpoint."""
    with atomic(out) as beside:
        beside.write_bytes(content)
    checkpoint.unlink(missing_ok=True)


def versions(kind: str) -> dict[str, object]:
    """Return format and versions for the metadata of an ONNX file."""
    return {"format": kind, "bumpymap": version("bumpymap"), "torch": torch.__version__}


_OPSET, _IR_VERSION = 17, 8
"""Versions of the operators and of the format of ONNX: old ones, for old versions of ONNX Runtime."""


class OnnxGraph:
    """Nodes and weights in the order in which they are added; each method returns the name of its output.

    torch's own exporter is no choice: the new one needs onnxscript, the old one is to be removed.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._nodes: list[onnx.NodeProto] = []
        self._weights: list[onnx.TensorProto] = []

    def constant(self, name: str, value: NDArray[np.generic] | np.generic) -> str:
        """Add a stored value."""
        self._weights.append(numpy_helper.from_array(np.asarray(value), name))
        return name

    def add(self, kind: str, *inputs: str, output: str | None = None, **attributes: Any) -> str:
        """Add one operator."""
        name = output or f"x{len(self._nodes)}"
        self._nodes.append(helper.make_node(kind, inputs, [name], **attributes))
        return name

    def conv(self, pair: Any, source: str) -> str:
        """Add torch's ``Conv2d``, or a `convolution`, whose batch normalisation is folded into it."""
        layer = pair
        if isinstance(pair, nn.Sequential):
            exact: Any = deepcopy(pair).double()
            layer = fuse_conv_bn_eval(exact[0], exact[1])
        name = f"conv{len(self._nodes)}"
        values = ((part, getattr(layer, part).detach().float().numpy()) for part in ("weight", "bias"))
        weights = [self.constant(f"{name}.{part}", value) for part, value in values]
        strides, pads = list(layer.stride), 2 * list(layer.padding)
        return self.add("Conv", source, *weights, strides=strides, pads=pads, group=layer.groups)

    def to_bytes(
        self, head: nn.Conv2d, source: str, inputs: Mapping[str, Sequence[int]], metadata: Mapping[str, object]
    ) -> bytes:
        """Add the last layer, whose output is ``probability`` (batch, classes); check the graph and serialise it.

        ``inputs``: name -> shape of one sample; ``metadata``: written as ``metadata_props``, text as it is, everything
        else as JSON.
        """
        self.add("Softmax", self.add("Flatten", self.conv(head, source), axis=1), output="probability", axis=1)
        infos = [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", *shape])
            for name, shape in (*inputs.items(), ("probability", [head.out_channels]))
        ]
        graph = helper.make_graph(self._nodes, self._name, infos[:-1], infos[-1:], self._weights)
        model = helper.make_model(
            graph, producer_name="bumpymap", opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR_VERSION
        )
        helper.set_model_props(model, {k: v if isinstance(v, str) else json.dumps(v) for k, v in metadata.items()})
        onnx.checker.check_model(model, full_check=True)
        return model.SerializeToString(deterministic=True)


def convolution(source: int, target: int, size: int, **options: Any) -> nn.Sequential:
    """Make a convolution without bias, followed by batch normalisation; ``options``: of torch's ``Conv2d``."""
    return nn.Sequential(nn.Conv2d(source, target, size, bias=False, **options), nn.BatchNorm2d(target))
