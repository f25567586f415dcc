"""Where ``bumpytiles.native`` keeps machine code between runs."""

import hashlib
import json
import logging
import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from bumpytiles._compiler import Code, found, machine, versions

__all__ = ["Store"]

_log = logging.getLogger(__name__)


class Store:
    """Where the machine code of one entry is kept: one file for each kind of processor, replaced when it is stale."""

    def __init__(self, function: Callable[..., Any]) -> None:
        source = Path(function.__code__.co_filename)
        processor = machine()
        parts = [source.read_bytes(), *_own_source(), versions(), processor, function.__name__.encode()]
        self._key = hashlib.sha256(b"\0".join(parts)).hexdigest()
        name = f"{source.stem}.{function.__name__}.{hashlib.sha256(processor).hexdigest()[:8]}.native"
        own = os.environ.get("NUMBA_CACHE_DIR")
        user = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "bumpytiles"
        self._files = [folder / name for folder in ([Path(own)] if own else [source.parent / "__pycache__", user])]

    @property
    def can_keep(self) -> bool:
        """Whether a folder can be written, or made."""
        folders = [next(folder for folder in file.parents if folder.exists()) for file in self._files]
        return any(folder.is_dir() and os.access(folder, os.W_OK) for folder in folders)

    def load(self) -> Code | None:
        """Return the machine code, None where there is none for this source, compiler and processor."""
        for file in self._files:
            with suppress(OSError, ValueError, KeyError):
                head, _, code = file.read_bytes().partition(b"\n")
                record = json.loads(head)
                whole = record["digest"] == hashlib.sha256(code).hexdigest()
                if whole and record["key"] == self._key and found(record["outside"]):
                    return Code(record["symbol"], record["outside"], code)
        return None

    def save(self, code: Code) -> None:
        """Keep machine code in the first folder that can be written; a file appears whole or not at all."""
        digest = hashlib.sha256(code.code).hexdigest()
        record = {"key": self._key, "digest": digest, "symbol": code.symbol, "outside": code.outside}
        for file in self._files:
            try:
                file.parent.mkdir(parents=True, exist_ok=True)
                part = file.with_name(f".{file.name}.{os.getpid()}")
                part.write_bytes(json.dumps(record).encode() + b"\n" + code.code)
                part.replace(file)
            except OSError as error:
                _log.debug("cannot keep compiled kernels in %s: %s", file.parent, error)
            else:
                return


@cache
def _own_source() -> list[bytes]:
    """Give the source of what makes machine code."""
    return [Path(__file__).with_name(name).read_bytes() for name in ("_compiler.py", "native.py")]
