"""ONNX files of our own networks: read, checked, run. The only module that imports ONNX Runtime.

Its builds report what they are used for to their maker, from the moment of the import on: an identifier of the machine
and a database of events in the user's cache, a thread that looks for the network. That is switched off before.
"""

import os
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from bumpymap.core.errors import BadInputError

__all__ = ["metadata_of", "onnx_runtime", "read_network", "session", "shipped_network"]


def onnx_runtime() -> Any:
    """Import ONNX Runtime, silent towards the network and on the terminal."""
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"  # it looks at this once, when it is loaded
    import onnxruntime

    onnxruntime.disable_telemetry_events()  # builds that report to the system they run on know this alone
    onnxruntime.set_default_logger_severity(3)
    return onnxruntime


@lru_cache(maxsize=4)
def session(content: bytes) -> Any:
    """Open a network for inference on one thread; the last few stay open."""
    runtime = onnx_runtime()
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    return runtime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


@lru_cache(maxsize=2)
def shipped_network(room: str, name: str) -> bytes:
    """Read a network that ships with a room of bumpymap: ``shipped_network("rating", "textures.onnx")``."""
    return (files(f"bumpymap.{room}") / "data" / "models" / name).read_bytes()


def read_network(path: Path, kind: str, remedy: str) -> bytes:
    """Read a file.

    Parameters
    ----------
    path : Path
    kind : str
        What it is, for the message: ``texture network``.
    remedy : str
        What to do without it.

    Raises
    ------
    BadInputError
        It cannot be read.
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
        What its property ``format`` must be.
    origin : str
        Where it is from, for messages.
    kind, remedy : str
        As for ``read_network``.

    Raises
    ------
    BadInputError
        It is no ONNX file, or none of ours.
    """
    try:
        metadata = dict(session(content).get_modelmeta().custom_metadata_map)
    except Exception as error:  # ONNX Runtime has its own family of exceptions, without a public base
        raise BadInputError(f"{origin} is not an ONNX model: {error}. {remedy}") from error
    if metadata.get("format") != format_name:
        raise BadInputError(f"{origin} is an ONNX model, but not a {kind} of bumpymap. {remedy}")
    return metadata
