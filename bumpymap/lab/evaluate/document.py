"""Write the report of an evaluation in Markdown and the same numbers in JSON."""

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import atomic

__all__ = ["REPORT", "number", "percent", "plain_record", "report_text", "section", "table", "write_document"]

REPORT = "report.md"
_RECORD = "report.json"
_NONE = "-"


def write_document(out: Path, text: str, kind: str, record: dict[str, Any]) -> list[Path]:
    """Write ``report.json`` and ``report.md`` into a folder, in this order.

    Parameters
    ----------
    out : Path
    text : str
        Text of the report.
    kind : str
        Format name of the JSON file.
    record : dict
        Nested records of numbers, strings and arrays.
    """
    content = {"format": kind, "version": 1} | plain_record(record)
    with atomic(out / _RECORD) as temporary:
        temporary.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    with atomic(out / REPORT) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return [out / REPORT, out / _RECORD]


def report_text(title: str, opening: Sequence[str], sections: Iterable[list[str]]) -> str:
    """Assemble the text of a report."""
    lines = [f"# {title}", "", *opening, *(line for part in sections for line in part)]
    return "\n".join(lines).rstrip() + "\n"


def section(title: str, intro: str, lines: Sequence[str]) -> list[str]:
    """Return the lines of a section, or none if ``lines`` is empty. ``intro`` may be empty."""
    return [f"## {title}", "", *([intro, ""] if intro else []), *lines] if lines else []


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    return [*lines, *(f"| {' | '.join(row)} |" for row in rows), ""]


def number(value: float, digits: int = 3) -> str:
    """Format a number with ``digits`` significant digits; a dash if it is not finite."""
    return f"{value:.{digits}g}" if math.isfinite(value) else _NONE


def percent(share: float) -> str:
    """Format a share of 0..1 as per cent; a dash if it is not finite."""
    return f"{100 * share:.1f} %" if math.isfinite(share) else _NONE


def plain_record(value: Any) -> Any:
    """Convert nested records to plain JSON: six digits, None for non-finite numbers, sets as sorted lists."""
    if isinstance(value, dict):
        return {str(key): plain_record(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple | frozenset):
        return [plain_record(item) for item in (sorted(value) if isinstance(value, frozenset) else value)]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value
