"""What a STAC item and a STAC catalogue share: version, identifiers, and the file that they are written to."""

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bumpymap.core import atomic

__all__ = ["STAC_VERSION", "identifier", "valid_text", "write_document"]

STAC_VERSION = "1.1.0"


def identifier(name: str) -> str:
    """Return a name with only letters of ASCII, digits, dots, ``-`` and ``_``, as STAC wants of an id.

    Of a name that has none of these the id is made from its checksum.
    """
    text = re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.")
    return text or f"survey-{hashlib.sha256(name.encode('utf-8', 'surrogateescape')).hexdigest()[:8]}"


def valid_text(name: str) -> str:
    """Return text as valid UTF-8: bytes of a file name that are not are written escaped, as in run.json."""
    return name.encode("utf-8", "backslashreplace").decode()


def write_document(document: Mapping[str, Any], path: Path) -> None:
    """Write JSON; lists of numbers stand in one line.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    text = re.sub(r"\[\n\s*([-+.\de]+(?:,\n\s*[-+.\de]+)*)\n\s*\]", lambda found: _one_line(found[1]), text)
    with atomic(path) as temporary:
        temporary.write_text(f"{text}\n", encoding="utf-8")


def _one_line(numbers: str) -> str:
    return f"[{', '.join(numbers.replace(',', ' ').split())}]"
