"""Read, check and run the ONNX files of bumpymap's networks. The only module that imports ONNX Runtime.

Builds of ONNX Runtime send telemetry from import on: they store a machine identifier and a database of events in the
user's cache and start a network thread. Telemetry is switched off before the import.
"""

import os
from collections.abc import Mapping
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core.errors import BadInputError
from bumpymap.core.files import read_regular
from bumpymap.core.processes import Child, DecoderError, Guard

_MOST_BYTES = 64 << 20
"""Size of the file of a network; the included ones have 0.4 MB."""
_MOST_SECONDS, _MOST_MEMORY = 20.0, 2 << 30
"""Processor time and bytes in which a network must run on a batch; the included ones take 0.05 s and 20 MB."""
_shipped: list[bytes] = []
"""Networks of the package, which need no limits."""


@lru_cache(maxsize=4)
def session(content: bytes) -> Any:
    """Open a network for inference on one thread, without telemetry and terminal output; the last four stay open."""
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"  # read once, when the library is loaded
    import onnxruntime as runtime

    runtime.disable_telemetry_events()  # the switch of builds for Windows
    runtime.set_default_logger_severity(4)  # errors are raised
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    options.add_session_config_entry("session.load_model_format", "ONNX")  # what was checked, whatever its first bytes
    # Without the fallback, which prints what a damaged file says.
    return runtime.InferenceSession(content, options, providers=["CPUExecutionProvider"], enable_fallback=0)


@lru_cache(maxsize=2)
def shipped_network(room: str, name: str) -> bytes:
    """Read a network that ships with a package of bumpymap: ``shipped_network("rating", "textures.onnx")``."""
    _shipped.append((files(f"bumpymap.{room}") / "data" / "models" / name).read_bytes())
    return _shipped[-1]


def read_network(path: Path, kind: str, remedy: str) -> bytes:
    """Read the file of a network.

    ``kind``: kind of network, for messages: ``texture network``; ``remedy``: advice for messages. Raises BadInputError:
    the file cannot be read, or is too large.
    """
    try:
        return read_regular(path, _MOST_BYTES)
    except OSError as error:
        raise BadInputError(f"cannot read the {kind} {path}: {error.strerror}. {remedy}") from error


def metadata_of(content: bytes, format_name: str, origin: str, kind: str, remedy: str) -> dict[str, str]:
    """Return the ``metadata_props`` of a network.

    ``content``: the ONNX file; ``format_name``: required value of its property ``format``; ``origin``: source of the
    file, for messages; ``kind`` and ``remedy``: as for ``read_network``. Raises BadInputError: the file is not an ONNX
    file that ONNX Runtime reads, or not a network of bumpymap.
    """
    metadata: dict[str, str] = _tried("read_metadata", content, origin, remedy)
    if metadata.get("format") != format_name:
        raise BadInputError(f"{origin} is an ONNX model, but not a {kind} of bumpymap. {remedy}")
    return metadata


def check_network(
    content: bytes, inputs: Mapping[str, tuple[int, ...]], classes: int, origin: str, remedy: str
) -> None:
    """Run a network once, on zeros.

    ``content``: the ONNX file, see `metadata_of`; ``inputs``: name of each input -> its shape, of a batch; ``classes``:
    the output has this many columns; ``origin`` and ``remedy``: as for ``metadata_of``. Raises BadInputError: it cannot
    be run, or gives something else.
    """
    shape, kind = _tried("run_on_zeros", content, origin, remedy, dict(inputs))
    expected = (next(iter(inputs.values()))[0], classes)
    if (shape, kind) != (expected, "float32"):
        raise BadInputError(
            f"{origin} is not an ONNX model that bumpymap runs: it gives {kind} of shape {shape}, and not float32 of "
            f"{expected}. {remedy}"
        )


def _tried(function: str, content: bytes, origin: str, remedy: str, *arguments: Any) -> Any:
    """Call a function of this module with a network; for one of others in a process with limits on memory and time."""
    if any(content is known for known in _shipped):
        return globals()[function](content, *arguments)
    guard = Guard(lambda: Child("to try a network", __name__), "tries networks", "onnxruntime")
    try:
        return guard.call(function, content, *arguments, seconds=_MOST_SECONDS, memory=_MOST_MEMORY)
    except DecoderError as error:
        raise BadInputError(f"{origin} is not an ONNX model that bumpymap runs: {error}. {remedy}") from error
    finally:
        guard.end()


def read_metadata(content: bytes) -> dict[str, str]:
    """Return the ``metadata_props`` of a network."""
    return dict(session(content).get_modelmeta().custom_metadata_map)


def run_on_zeros(content: bytes, inputs: Mapping[str, tuple[int, ...]]) -> tuple[tuple[int, ...], str]:
    """Return shape and type of what a network gives for zeros."""
    found = session(content).run(None, {name: np.zeros(shape, np.float32) for name, shape in inputs.items()})[0]
    return tuple(found.shape), str(found.dtype)
