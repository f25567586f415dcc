"""Print lists of records as Markdown tables."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from bumpymap.lab.evaluate.report import number, table


def show_records(title: str, rows: Sequence[Any]) -> None:
    """Print dataclasses of one kind, a row each; nothing without rows."""
    if rows:
        cells = [[_text(value) for value in asdict(row).values()] for row in rows]
        print("\n".join([f"## {title}", "", *table(list(asdict(rows[0])), cells)]), flush=True)


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return " / ".join(map(_text, value))
    return number(value, 4) if isinstance(value, float) else str(value)
