"""What a batch knows of its surveys so far: written at the end, and now and then during the night."""

import logging
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic

from bumpymap.core import BumpymapError, OutputError, without_keys
from bumpymap.layers import SurveyRow, SurveyView, is_complete, map_facts, write_batch_summary, write_catalog
from bumpymap.survey.batch.one_survey import MapTask, look_at

__all__ = ["Results"]

_log = logging.getLogger(__name__)
_EVERY_S = 60.0
"""After a kill, or while the batch runs, the page is at most so much older than the last survey that ended."""
_WAITING = "the batch has not come to it yet, or ended before"
_EARLIER = "the batch has not come to it; it has layers of an earlier start, not compared with its files and settings"


class Results:
    """The rows of a batch, and its summary and page in a folder.

    Parameters
    ----------
    tasks : sequence of MapTask
    folder : Path
        Gets summary.csv, summary.parquet, index.html and, unless the layers go to a server, catalog.json.
    title : str
        Of the page.
    """

    def __init__(self, tasks: Sequence[MapTask], folder: Path, title: str) -> None:
        self._tasks, self._folder, self._title = {task.name: task for task in tasks}, folder, title
        self._rows = {
            task.name: SurveyRow(task.name, "not reached", _WAITING, survey=without_keys(str(task.config.surveys[0])))
            for task in tasks
        }
        self._views: dict[str, SurveyView] = {}
        self._ended: set[str] = set()
        self._written = monotonic()

    @property
    def rows(self) -> tuple[SurveyRow, ...]:
        """One for each survey, by name."""
        return tuple(self._rows[name] for name in sorted(self._rows))

    def add(self, row: SurveyRow, view: SurveyView) -> None:
        """Note what became of a survey; write the files if that is long ago."""
        self._rows[row.name], self._views[row.name] = row, view
        self._ended.add(row.name)
        if monotonic() - self._written > _EVERY_S:
            try:
                self._write(" while the batch was running")
            except OutputError as error:
                _log.warning("%s", error)
            self._written = monotonic()

    def write_last(self) -> None:
        """Write the files; of surveys that were not reached, with what their layers of earlier starts say.

        Raises
        ------
        OutputError
            They cannot be written.
        """
        for name in self._rows.keys() - self._ended:
            task = self._tasks[name]
            if task.remote is None and not task.config.out.is_symlink() and is_complete(task.config.out):
                with suppress(BumpymapError):
                    facts = map_facts(task.config.out)
                    self._rows[name] = replace(self._rows[name], message=_EARLIER, **facts)
                    self._views[name] = look_at(task.config.out, task.thumbnail_bytes)
        if all(task.remote is None for task in self._tasks.values()):
            write_catalog(self._folder, [row.name for row in self.rows if row.status != "failed"], title=self._title)
        self._write()

    def _write(self, when: str = "") -> None:
        note = f"Written {datetime.now(UTC):%Y-%m-%d %H:%M} UTC{when}"
        write_batch_summary(self.rows, self._folder, self._views, self._title, note)
