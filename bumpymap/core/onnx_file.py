"""Read, check and run the ONNX files of bumpymap's networks. The only module that imports ONNX Runtime.

Builds of ONNX Runtime send telemetry from import on: they store a machine identifier and a database of events in the
user's cache and start a network thread. Telemetry is switched off before the import.
"""

import os
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from bumpymap.core.errors import BadInputError

__all__ = ["metadata_of", "onnx_runtime", "read_network", "session", "shipped_network"]


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
        The file cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise BadInputError(f"cannot read the {kind} {path}: {error}. {remedy}") from error


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
        The file is not an ONNX file, or not a network of bumpymap.
    """
    try:
        metadata = dict(session(content).get_modelmeta().custom_metadata_map)
    except Exception as error:  # ONNX Runtime's exceptions have no public base
        raise BadInputError(f"{origin} is not an ONNX model: {error}. {remedy}") from error
    if metadata.get("format") != format_name:
        raise BadInputError(f"{origin} is an ONNX model, but not a {kind} of bumpymap. {remedy}")
    return metadata
