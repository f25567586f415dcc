"""The result of a run of the main job."""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from bumpymap.layers import MapSummary
from bumpymap.survey.flight_lines import FlightLines

__all__ = ["MapResult", "WarningCollector", "collected_warnings"]


class WarningCollector(logging.Handler):
    """Keeps warnings, those of the thread that made it or of all, as pairs of level and message."""

    def __init__(self, *, every_thread: bool = False) -> None:
        super().__init__(logging.WARNING)
        self.kept: list[tuple[str, str]] = []
        self._thread = None if every_thread else threading.get_ident()

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record."""
        try:
            if self._thread in {None, record.thread}:
                self.kept.append((record.levelname.lower(), record.getMessage()))
        except Exception:  # noqa: BLE001 (a log call with wrong arguments must not end a run)
            self.handleError(record)


@contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """Collect the warnings of bumpymap during the body, beside their being logged."""
    collector, logger, texts = WarningCollector(), logging.getLogger("bumpymap"), list[str]()
    logger.addHandler(collector)
    try:
        yield texts
    finally:
        logger.removeHandler(collector)
        texts += [message for _, message in collector.kept]


@dataclass(frozen=True, slots=True)
class MapResult:
    """What a run wrote and found."""

    files: tuple[Path, ...]
    """Files written, in the order of writing."""
    summary: MapSummary
    """Statistics of the rated tiles."""
    points: int
    """Points read that are neither withheld nor noise; duplicates are included."""
    ground_only: bool
    """Only ground was measured: points of class 2, or those that the cloth filter found (``ground = "csf"``)."""
    skipped: dict[str, str]
    """Inputs that could not be read, with the error message (``skip_bad``)."""
    seconds: dict[str, float]
    """Wall time by stage."""
    lines: FlightLines
    """Steps between flight lines, and what was taken off."""
    rates_thin: bool
    """Thin tiles were rated from their points."""
    sheets: int = 0
    """Sheets that the layers are written in; 0: one map."""
    already_done: bool = False
    """An earlier run with the same inputs and settings is complete: nothing was written, and these are its results."""
