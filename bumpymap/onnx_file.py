"""ONNX files of our own networks: read, checked, run. The only module that imports ONNX Runtime."""

from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from bumpymap.errors import BadInputError

__all__ = ["metadata_of", "read_network", "session", "shipped_network"]


@lru_cache(maxsize=4)
def session(content: bytes) -> Any:
    """Open a network for inference on one thread; the last few stay open."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


@lru_cache(maxsize=2)
def shipped_network(name: str) -> bytes:
    """Read a network that ships with bumpymap."""
    return (files("bumpymap") / "data" / "models" / name).read_bytes()


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
