"""What every evaluation leaves: a report in Markdown for people, the same numbers in JSON for machines."""

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
    """Write ``report.md`` and ``report.json`` into a folder; the report comes last.

    Parameters
    ----------
    out : Path
    text : str
        Of the report.
    kind : str
        Format of the JSON file.
    record : dict
        Nested records of numbers, texts and arrays.
    """
    content = {"format": kind, "version": 1} | plain_record(record)
    with atomic(out / _RECORD) as temporary:
        temporary.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    with atomic(out / REPORT) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return [out / REPORT, out / _RECORD]


def report_text(title: str, opening: Sequence[str], sections: Iterable[list[str]]) -> str:
    """Join the lines of a report."""
    lines = [f"# {title}", "", *opening, *(line for part in sections for line in part)]
    return "\n".join(lines).rstrip() + "\n"


def section(title: str, intro: str, lines: Sequence[str]) -> list[str]:
    """Lines of a section; none where there is nothing to say. ``intro`` may be empty."""
    return [f"## {title}", "", *([intro, ""] if intro else []), *lines] if lines else []


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    return [*lines, *(f"| {' | '.join(row)} |" for row in rows), ""]


def number(value: float, digits: int = 3) -> str:
    """Give so many significant digits; a dash where nothing is known."""
    return f"{value:.{digits}g}" if math.isfinite(value) else _NONE


def percent(share: float) -> str:
    """Give a share of 0..1 as per cent."""
    return f"{100 * share:.1f} %" if math.isfinite(share) else _NONE


def plain_record(value: Any) -> Any:
    """Turn nested records into what JSON has: six digits, None for what is not finite, lists in a fixed order."""
    if isinstance(value, dict):
        return {str(key): plain_record(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple | frozenset):
        return [plain_record(item) for item in (sorted(value) if isinstance(value, frozenset) else value)]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value
