"""Map the surveys of a batch: find them, map what is not done, note what fails, and summarise."""

import logging
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from bumpymap.core import (
    Holder,
    MapConfig,
    UsageError,
    brief_repr,
    count_text,
    locked,
    refuse_faults,
    remove_empty_on_error,
    without_keys,
)
from bumpymap.layers import BATCH_LOG, SurveyRow, SurveyStatus, check_batch_out
from bumpymap.survey.batch.log import BatchLog
from bumpymap.survey.batch.one_survey import MapTask, TaskEnd
from bumpymap.survey.batch.remote import check_remote_out, fetch_log, upload_summary
from bumpymap.survey.batch.results import Results
from bumpymap.survey.batch.settings import BatchConfig
from bumpymap.survey.batch.source import ListedSurvey, list_surveys
from bumpymap.survey.batch.table import SettingsCheck
from bumpymap.survey.batch.workers import map_tasks
from bumpymap.survey.engine import connect

__all__ = ["BatchReport", "BatchResult", "run_batch"]

_log = logging.getLogger(__name__)
_GOOD: tuple[SurveyStatus, ...] = ("done", "already done")
_WITH_LAYERS: tuple[SurveyStatus, ...] = (*_GOOD, "incomplete")
_ALL, _SOME, _NONE = 0, 4, 3
_MOST_THUMBNAIL, _MOST_THUMBNAILS = 12_000, 900_000
"""Bytes of one picture, and of all on the page together."""

BatchReport: TypeAlias = Callable[[SurveyRow], None]
"""Receives the row of each survey that has ended."""


@dataclass(frozen=True, slots=True)
class BatchResult:
    """What became of the surveys of a batch."""

    __repr__ = brief_repr

    rows: tuple[SurveyRow, ...]
    """One for each survey, by name."""

    def with_status(self, *statuses: SurveyStatus) -> list[SurveyRow]:
        """Return the rows with one of these statuses."""
        return [row for row in self.rows if row.status in statuses]

    @property
    def exit_code(self) -> int:
        """0: all surveys are done. 4: some are. 3: none has layers."""
        if len(self.with_status(*_GOOD)) == len(self.rows):
            return _ALL
        return _SOME if self.with_status(*_WITH_LAYERS) else _NONE


def run_batch(
    config: BatchConfig,
    report: BatchReport | None = None,
    begin: Callable[[int], None] | None = None,
    spell: Callable[[str], str] = str,
) -> BatchResult:
    """Map many surveys, each to a folder of its own in ``config.out``.

    A survey that is done, by inputs, settings and versions, is left as it is; one whose run was interrupted is
    continued; one that fails is noted. A batch that was ended at any moment is continued by the same call.

    Parameters
    ----------
    config : BatchConfig
    report : callable, optional
        Receives the row of each survey when it has ended.
    begin : callable, optional
        Receives the number of surveys before the first begins.
    spell : callable, optional
        Changes messages before they are written, as `as_options` of the command line does.

    Raises
    ------
    BadInputError
        The source holds no surveys.
    UsageError
        Settings or rows of a CSV that are not allowed; nothing was begun.
    OutputError
        ``config.out`` cannot be written, is in use, or holds files of something else.
    """
    settings = SettingsCheck()
    refuse_faults(settings.faults(config.merged({}), complete=False), "settings for all surveys", UsageError)
    surveys = list_surveys(config.source, config.survey_per, lambda own: settings.faults(config.merged(own)))
    tasks, folder, remote = _tasks(config, surveys), config.folder, config.remote
    _require_scheduler(tasks[0].config)
    if remote is None:
        check_batch_out(folder)
    else:
        with remove_empty_on_error(folder):
            check_remote_out(remote, folder)
    if begin is not None:
        begin(len(surveys))
    with remove_empty_on_error(folder), locked(folder):
        if remote is not None:
            fetch_log(remote, folder)
        with BatchLog.opened(folder / BATCH_LOG) as log:
            log.write("start", source=str(config.source), surveys=len(surveys), jobs=config.jobs)
            _note_renamed(log, surveys)
            results = Results(tasks, folder, _title(config.out))
            ends = map_tasks(tasks, config.jobs, lambda task: log.write("survey started", name=task.name))
            try:
                with closing(ends):
                    for end in ends:
                        row = end.row
                        message, survey = map(without_keys, (spell(row.message), row.survey))
                        warnings = tuple(without_keys(spell(warning)) for warning in row.warnings)
                        row = replace(row, message=message, warnings=warnings, survey=survey)
                        _note(log, replace(end, row=row))
                        results.add(row, end.view)
                        if report is not None:
                            report(row)
            finally:
                results.write_last()
                result = BatchResult(results.rows)
                counts = {kind: len(result.with_status(kind)) for kind in sorted({row.status for row in result.rows})}
                log.write("end", counts=counts, exit_code=result.exit_code)
                if remote is not None:
                    upload_summary(remote, folder)
    if remote is not None:
        with suppress(OSError):  # layers that could not be uploaded are in it
            folder.rmdir()
    return result


def _require_scheduler(config: MapConfig) -> None:
    """Raise UsageError if the scheduler does not answer: else each survey would wait for it."""
    if config.scheduler is not None:
        with connect(config.scheduler):
            pass


def _title(out: Path | str) -> str:
    """Return the name of a batch: that of its folder."""
    return str(out).rstrip("/").rsplit("/", 1)[-1] if isinstance(out, str) else out.absolute().name


def _tasks(config: BatchConfig, surveys: list[ListedSurvey]) -> list[MapTask]:
    """Return the surveys to map: by name, or the largest first if several run at a time, so that none is left alone."""
    jobs, holder = min(config.jobs, len(surveys)), Holder.here()
    tasks = [
        MapTask(
            survey.name,
            config.share(config.of_survey(survey.settings, (survey.place,), survey.name), jobs),
            config.overwrite,
            None if config.remote is None else config.remote.below(survey.name),
            min(_MOST_THUMBNAIL, _MOST_THUMBNAILS // len(surveys)),
            config.of_survey(survey.settings).memory,
            holder,
        )
        for survey in surveys
    ]
    return tasks if jobs == 1 else sorted(tasks, key=lambda task: -_size(task.config.surveys[0]))


def _size(place: Path | str) -> int:
    """Return the bytes of a local file or of those in a folder; 0 if that is not known."""
    if isinstance(place, str):
        return 0
    with suppress(OSError):
        files = place.rglob("*") if place.is_dir() else [place]
        return sum(file.stat().st_size for file in files if file.is_file())
    return 0


def _note_renamed(log: BatchLog, surveys: list[ListedSurvey]) -> None:
    renamed = [survey for survey in surveys if survey.renamed]
    for survey in renamed:
        log.write("renamed", name=survey.name, survey=str(survey.place))
    if renamed:
        first = renamed[0]
        _log.warning(
            "%s the name of another; a longer name is used, such as %s for %s",
            count_text(len(renamed), "survey has", "surveys have"),
            first.name,
            without_keys(str(first.place)),
        )


def _note(log: BatchLog, end: TaskEnd) -> None:
    row = end.row
    for event in end.events:
        log.write(**{**event, "name": row.name})
    facts = {"status": row.status, "seconds": row.seconds, "points": row.points, "message": row.message}
    log.write("survey ended", name=row.name, **{key: value for key, value in facts.items() if value not in {None, ""}})
    for warning in row.warnings:
        _log.warning("%s: %s", row.name, warning)
    if row.status in {"failed", "incomplete"}:
        _log.warning("%s %s: %s", row.name, "failed" if row.status == "failed" else "is incomplete", row.message)
