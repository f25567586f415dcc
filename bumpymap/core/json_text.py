"""Parse JSON from untrusted files, with a limit on the nesting depth."""

import json
from typing import Any

__all__ = ["parse_json"]

_DEEPEST = 50
"""Deeper than any file that bumpymap writes."""


def parse_json(text: str) -> Any:
    """Parse JSON text.

    Raises
    ------
    ValueError
        Not JSON, or nested more than 50 deep.
    """
    try:
        value = json.loads(text)
    except RecursionError:
        raise ValueError(f"it is nested more than {_DEEPEST} deep") from None
    level = [value]
    for _ in range(_DEEPEST):
        level = [child for item in level for child in _children(item)]
        if not level:
            return value
    raise ValueError(f"it is nested more than {_DEEPEST} deep")


def _children(item: Any) -> list[Any]:
    if isinstance(item, dict):
        item = list(item.values())
    return [child for child in item if isinstance(child, dict | list)] if isinstance(item, list) else []
