"""Map the surveys of a batch: find them, map what is not done, note what fails, and summarise.

Each worker process maps one survey after another, so that Python and its libraries start once. Processes, not threads:
a survey that crashes native code, or takes the last memory, ends its worker alone, and another is started. Everything
else that a survey can cause is in its row of the results.
"""

import csv
import io
import logging
import os
import re
import time
import traceback
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cache, partial
from itertools import chain, count
from pathlib import Path
from time import monotonic
from typing import Any, TypeAlias, Unpack, get_origin

from bumpymap.core import (
    CLASHES,
    BadInputError,
    BumpymapError,
    MapConfig,
    NameOrFile,
    OutputError,
    PageSettings,
    TooUnknownError,
    UsageError,
    brief_repr,
    call_in_children,
    count_text,
    lock_for,
    lock_holder,
    locked,
    missing_resource,
    parse_crs,
    parse_record,
    path_fault,
    path_of_call,
    read_regular,
    refuse_clashes,
    refuse_faults,
    refused_write,
    remove_empty_on_error,
    settings_with_options,
    short_repr,
    unknown_text,
    value_of_text,
    with_pixels,
)
from bumpymap.layers import (
    BATCH_LINKS,
    BATCH_NAMES,
    REPORT_NAME,
    SurveyRow,
    SurveyStatus,
    check_batch_out,
    import_without_pandas,
    is_complete,
    map_facts,
    write_batch_summary,
)
from bumpymap.rating import Calibration, find_calibration
from bumpymap.readers import find_surveys
from bumpymap.survey.batch.settings import OWN_SETTINGS, BatchConfig, MapSettings, PathLike, SurveyPer, map_settings
from bumpymap.survey.engine import connect
from bumpymap.survey.pipeline import collected_warnings, map_surveys
from bumpymap.views import SurveyView, index_page, page_header, read_thumbnail

_LISTS = (".txt", ".csv")
_SURVEY, _NAME = "survey", "name"
_KINDS = {each.name: each.kind for each, _ in settings_with_options(MapConfig) if each.name not in OWN_SETTINGS}
"""Column -> type of its setting."""

Row = tuple[Path, str, dict[str, Any]]
"""A survey of a batch: its file or folder; its name (of the folder of its layers; empty: none is given); settings."""
Check = Callable[[Mapping[str, Any]], list[str]]
"""Returns what is wrong with the settings of a row."""


def name_surveys(surveys: Sequence[Path], given: Sequence[str], root: Path) -> list[str]:
    """Return a folder name for each survey; no two are the same, even where upper and lower case are.

    A survey is named after its file without the suffix. Those of one name get the names of their folders too
    (``north_site``, ``south_site``), and what is left a number (``site``, ``site_2``). ``surveys``: file or folder of
    each; ``given``: names that the user chose, which are kept; empty: none; ``root``: folders below this one count for
    a name.
    """
    usual = [_clean(survey.name if survey.is_dir() else re.sub(r"(?i)\.copc$", "", survey.stem)) for survey in surveys]
    times = Counter((own or name).casefold() for own, name in zip(given, usual, strict=True))
    used = {own.casefold() for own in given if own}
    names = []
    for survey, own, name in zip(surveys, given, usual, strict=True):
        folders = survey.relative_to(root).parts if survey.is_relative_to(root) else survey.parts[-2:]
        wanted = _clean("_".join([*folders[:-1], name])) if times[name.casefold()] > 1 else name
        numbered = chain([wanted], (f"{wanted}_{number}" for number in count(2)))
        names.append(own or next(free for free in numbered if free.casefold() not in used and not _is_reserved(free)))
        used.add(names[-1].casefold())
    return names


def plain_name(name: str) -> str:
    """Return what is wrong with a name that a user gave; empty if it can be that of a folder."""
    if "/" in name or "\0" in name or name.startswith(".") or _is_reserved(name):
        return "it must be the name of a folder: no slash, no dot at its start, no name of a file of the batch"
    return ""


def _clean(name: str) -> str:
    """Return a name that is not hidden and not empty."""
    return name.strip().lstrip(".") or "survey"


def _is_reserved(name: str) -> bool:
    return name.casefold() in {*BATCH_NAMES, "run.json"}


def _table(text: str, origin: str, folder: Path, check: Check) -> tuple[list[Row], list[str]]:
    """Parse the CSV of a batch: its column ``survey``, if wanted ``name``, and settings of a map, spelled as options.

    A cell is what follows ``--set KEY=``, a list may have spaces instead of commas; an empty one means that the setting
    is not given. A table that Excel wrote with semicolons is read too. ``folder``: folder at which relative paths
    start. Returns the rows, and what is wrong with columns and values. Raises UsageError: it is no such table.
    """
    header, _, _ = text.partition("\n")
    table = csv.DictReader(io.StringIO(text), restval="", delimiter=";" if ";" in header and "," not in header else ",")
    try:
        titles = [title.strip() for title in table.fieldnames or ()]
        table.fieldnames = columns = [title.lower().lstrip("-").replace("-", "_") for title in titles]
        lines = [(table.line_num, line) for line in table]
    except csv.Error as error:
        raise UsageError(f"{origin}: line {table.line_num} is not CSV: {error}") from error
    known = [_SURVEY, _NAME, *_KINDS]
    if _SURVEY not in columns:
        raise UsageError(f"{origin}: there is no column {_SURVEY}; there are: {', '.join(known)}")
    faults: list[str] = []
    if unknown := [title for title, name in zip(titles, columns, strict=True) if name not in {"", *known}]:
        faults.append(unknown_text(unknown, known, "column").replace("`", ""))
    if repeated := sorted({name for name in columns if name and columns.count(name) > 1}):
        faults.append(f"the column {', '.join(repeated)} is there twice")
    rows = []
    for number, line in lines:
        more = [cell for cell in line.pop(None, []) if cell.strip()]
        given = {name: cell.strip() for name, cell in line.items() if name in known and cell.strip()}
        if given or more:
            wrong = [f"it has {len(columns) + len(more)} cells, the header has {len(columns)}"] if more else []
            rows.append(_row(given, folder, wrong, check))
            faults += [f"line {number}: {why}" for why in wrong]
    times = Counter(name.casefold() for _, name, _ in rows if name)
    return rows, faults + [f"the name {name} is given twice" for name in sorted(times) if times[name] > 1]


def _row(given: dict[str, str], folder: Path, wrong: list[str], check: Check) -> Row:
    """Return a row of cells by column; append what is wrong with it to ``wrong``."""
    place, name = given.pop(_SURVEY, ""), given.pop(_NAME, "")
    if not place or path_fault(place):
        wrong.append(path_fault(place) or "the survey is empty")
    elif not (folder / place).exists():
        wrong.append(f"there is no file or folder {folder / place}")
    if name and (why := plain_name(name)):
        wrong.append(f"the name is {name!r}; {why}")
    settings: dict[str, Any] = {}
    for key, cell in given.items():
        kind, value = _KINDS[key], cell
        if get_origin(kind) is tuple:
            value = value_of_text(",".join(cell.replace(",", " ").split()), kind)
        elif kind not in (str, Path, NameOrFile):
            value = value_of_text(cell.lower() if kind is bool else cell, kind)  # Excel writes TRUE
        own, more = parse_record({key: value}, MapConfig, folder)
        settings |= {} if more else own
        wrong += more
    with _noted(wrong):
        refuse_clashes(settings, CLASHES)
        MapConfig(surveys=(), out=Path(), **settings)
    wrong += [why for why in check(settings) if why not in wrong]
    return (folder / place, name, settings)


def settings_faults(
    settings: Mapping[str, Any],
    calibration: Callable[..., Calibration],
    header: Callable[[PageSettings], object],
    *,
    complete: bool = True,
) -> list[str]:
    """Return what is wrong with settings of surveys: values, CRS, and vehicles and files that cannot be used.

    ``calibration`` finds the calibration of a vehicle, ``header`` reads the logo of a page; ``complete``: no other
    settings come to these, so that they must also fit each other.
    """
    faults: list[str] = []
    for name in ("crs", "force_crs"):
        if settings.get(name) is not None:
            with _noted(faults):
                parse_crs(settings[name], name)
    with _noted(faults):
        config = MapConfig(surveys=(), out=Path(), **with_pixels(settings))
        found = calibration(config.vehicle, config.calibration, config.tile_size)
        if complete:
            found.require_grid(config.tile_size, config.pixels)
    with _noted(faults):
        header(settings.get("page") or PageSettings())
    if settings.get("model") is not None and not settings["model"].is_file():
        faults.append(f"there is no file {settings['model']}, given as the model")
    return faults


@contextmanager
def _noted(faults: list[str]) -> Iterator[None]:
    """Append the message of an error to a list instead."""
    try:
        yield
    except BumpymapError as error:
        faults.append(str(error).replace("`", ""))  # columns: no options of the command line


def list_surveys(source: Path, survey_per: SurveyPer, check: Check = lambda _: []) -> list[Row]:
    """Return the surveys of a batch by name; places are absolute, so that a batch can be continued from anywhere.

    Raises BadInputError: the source does not exist or holds no surveys; UsageError: a list with faults, all of which
    the message names.
    """
    if source.is_dir():
        places = _folders(source) if survey_per == "folder" else find_surveys([source.absolute()])
        rows: list[Row] = [(place, "", {}) for place in places]
    else:
        rows = _listed(source, check)
    root = _absolute(source if source.is_dir() else source.parent)
    places = [_absolute(place) for place, _, _ in rows]
    repeated = [place for place, times in Counter(map(str, places)).items() if times > 1]
    refuse_faults([f"{place} is listed twice" for place in repeated], str(source), UsageError)
    names = name_surveys(places, [name for _, name, _ in rows], root)
    found = [(place, name, own) for name, place, (_, _, own) in zip(names, places, rows, strict=True)]
    return sorted(found, key=lambda survey: survey[1])


def _listed(source: Path, check: Check) -> list[Row]:
    if not source.exists():
        raise BadInputError(f"{source} does not exist; name a folder of surveys, or a list of them (.txt or .csv)")
    suffix = source.suffix.lower()
    if suffix not in _LISTS or not source.is_file():
        raise UsageError(
            f"{source} is neither a folder nor a list ({' or '.join(_LISTS)}); a single survey is mapped by "
            "`bumpymap map`"
        )
    try:  # bytes that are not UTF-8 are kept, since they may be those of a file name
        text = read_regular(source).decode("utf-8-sig", "surrogateescape")
    except OSError as error:
        raise BadInputError(f"cannot read {source}: {error.strerror}") from error
    folder = _absolute(source.parent)
    if suffix == ".csv":
        rows, faults = _table(text, str(source), folder, check)
    else:
        lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
        wanted = [(number, line) for number, line in lines if line and not line.startswith("#")]
        rows = [(folder / line, "", {}) for _, line in wanted]
        faults = [f"line {number}: {why}" for number, line in wanted if (why := path_fault(line))]
    refuse_faults(faults, str(source), UsageError)
    if not rows:
        raise BadInputError(f"{source} names no survey")
    return rows


def _folders(source: Path) -> list[Path]:
    """Return the folders in the source that hold surveys."""
    try:
        inside = sorted(path for path in source.absolute().iterdir() if not path.name.startswith("."))
    except OSError as error:
        raise BadInputError(f"cannot list the folder {source}: {error.strerror}") from error
    every = find_surveys([source.absolute()])
    loose = [path.name for path in inside if path in every]
    if loose:
        raise UsageError(
            f"`survey_per='folder'`: {source} itself holds {', '.join(loose[:3])}, which would belong to no survey. "
            "Move them to a folder"
        )
    found = [folder for folder in inside if any(folder in Path(file).parents for file in every)]
    for folder in inside:
        if folder.is_dir() and folder not in found:
            _log.warning("%s holds no point cloud, so it is no survey", folder)
    return list(found)


def _absolute(path: Path) -> Path:
    """Return the path from the root, without ``..``; links stay, since their names are those of surveys."""
    return Path(os.path.abspath(path))  # noqa: PTH100 (resolve follows links)


_MOST_WAIT_S = 5.0
"""Longest wait for children that were asked to end, s."""


@dataclass(frozen=True, slots=True)
class MapTask:
    """One survey to map."""

    name: str
    config: MapConfig
    """Its settings, with its share of threads and memory."""
    started_by: Mapping[str, Any] = field(default_factory=dict)
    """The batch, for whoever finds the folder locked."""

    @property
    def survey(self) -> str:
        """Its files and folders."""
        return " ".join(map(str, self.config.surveys))


TaskEnd: TypeAlias = tuple[SurveyRow, str]
"""Row of a survey that was mapped, and the traceback of an unexpected error; else empty."""


def map_one(task: MapTask) -> TaskEnd:
    """Map a survey, continue its interrupted run, or find that it is done; in a process that does nothing else."""
    begin = time.perf_counter()
    import_without_pandas("pyogrio.raw")
    trace = ""
    lock_for(task.started_by)
    with collected_warnings(alone=True) as said:
        try:
            row = _mapped(task)
        except Exception as error:  # noqa: BLE001 (the other surveys are mapped all the same)
            message = str(error)
            if not isinstance(error, BumpymapError):
                trace, full = traceback.format_exc(), refused_write(error)
                message = f"{type(error).__name__}: {error}" + (f" ({full})" if full else "")
            if what := missing_resource(error):
                advice = "give fewer `jobs` or less `memory`"
                message = f"the machine has no {what} left for this: {advice}. {message}"
            row = _failed(task, message, time.perf_counter() - begin)
    return replace(row, warnings=tuple(dict.fromkeys([*row.warnings, *said]))), trace


def _mapped(task: MapTask) -> SurveyRow:
    from bumpymap.survey.advice import require_known

    out = task.config.out
    if out.is_symlink():
        raise OutputError(f"{out} is a link, which is not followed. Remove it")
    # A worker of a batch that was killed takes a moment to end.
    end = time.monotonic() + _MOST_WAIT_S
    while out.is_dir() and time.monotonic() < end:
        try:
            with locked(out):
                break
        except OutputError:
            time.sleep(_MOST_WAIT_S / 50)
    result = map_surveys(task.config, in_batch=True)
    message = ""
    status: SurveyStatus = "incomplete" if result.skipped else "already done" if result.already_done else "done"
    if result.skipped:
        path, why = next(iter(result.skipped.items()))
        message = f"{count_text(len(result.skipped), 'file was', 'files were')} skipped, such as {path}: {why}"
    try:
        require_known(result, task.config)
    except TooUnknownError as error:
        message, status = f"{message} {error}".strip(), "incomplete"
    return SurveyRow(task.name, status, message, survey=task.survey, **map_facts(out))


def _failed(task: MapTask, message: str, seconds: float) -> SurveyRow:
    return SurveyRow(task.name, "failed", message, seconds=round(seconds, 3), survey=task.survey)


_MODULE = "bumpymap.survey.batch.run"


def map_tasks(tasks: Sequence[MapTask], jobs: int) -> Generator[TaskEnd, None, None]:
    """Map surveys, up to ``jobs`` at a time; yield the result of each as soon as it is known.

    ``tasks``: they are begun in this order. Raises UsageError: no process can be started.
    """
    # A run that is under way is ended as by a kill; the next start continues it.
    calls = call_in_children("to map surveys", _MODULE, "map_one", [(task,) for task in tasks], jobs)
    with closing(calls) as ends:
        for number, seconds, end in ends:
            if isinstance(end, Exception):
                message = (
                    f"its process {end}. If memory ran out, give fewer `jobs` or less `memory`; the next start "
                    "continues this survey"
                )
                yield _failed(tasks[number], message, seconds), ""
            else:
                yield end


_log = logging.getLogger(__name__)
_EVERY_S = 60.0
"""After a kill, or while the batch runs, the page is at most so much older than the last survey that ended."""
_MOST_THUMBNAIL, _MOST_THUMBNAILS = 40_000, 1_200_000
"""Characters of one picture, and of all on the page together."""
_WAITING = "the batch has not come to it yet, or ended before"
_EARLIER = "the batch has not come to it; it has layers of an earlier start, not compared with its files and settings"


class Results:
    """The rows of a batch; ``folder`` gets summary.csv, summary.parquet, collection.json and index.html."""

    def __init__(self, tasks: Sequence[MapTask], folder: Path) -> None:
        self._tasks, self._folder = {task.name: task for task in tasks}, folder
        self._rows = {task.name: SurveyRow(task.name, "not reached", _WAITING, survey=task.survey) for task in tasks}
        self._views: dict[str, SurveyView] = {}
        self._most = min(_MOST_THUMBNAIL, _MOST_THUMBNAILS // len(tasks))
        self._written = monotonic()

    @property
    def rows(self) -> tuple[SurveyRow, ...]:
        """One for each survey, by name."""
        return tuple(self._rows[name] for name in sorted(self._rows))

    def add(self, row: SurveyRow) -> None:
        """Note the result of a survey; write the files if that is long ago."""
        self._rows[row.name] = row
        if row.status != "failed":
            self._look_at(row.name)
        if monotonic() - self._written > _EVERY_S:
            try:
                self._write(" while the batch was running")
            except OutputError as error:
                _log.warning("%s", error)
            self._written = monotonic()

    def write_last(self) -> None:
        """Write the files; of surveys that were not reached, with what their layers of earlier starts say.

        Raises OutputError: they cannot be written.
        """
        for row in self.rows:
            out = self._tasks[row.name].config.out
            if row.status == "not reached" and not out.is_symlink() and is_complete(out):
                with suppress(BumpymapError):
                    self._rows[row.name] = replace(row, message=_EARLIER, **map_facts(out))
                    self._look_at(row.name)
        self._write()

    def _look_at(self, name: str) -> None:
        """Keep what the page shows of a complete map."""
        folder = self._tasks[name].config.out
        self._views[name] = SurveyView(read_thumbnail(folder, self._most), (folder / REPORT_NAME).is_file())

    def _write(self, when: str = "") -> None:
        note, title = f"Written {datetime.now(UTC):%Y-%m-%d %H:%M} UTC{when}", self._folder.absolute().name
        page = index_page(self.rows, self._views, BATCH_LINKS, title, note)
        write_batch_summary(self.rows, self._folder, title, page)


BatchReport: TypeAlias = Callable[[SurveyRow], None]
"""Receives the row of each survey that has ended."""


@dataclass(frozen=True, slots=True)
class BatchResult:
    """Results of the surveys of a batch."""

    __repr__ = brief_repr

    rows: tuple[SurveyRow, ...]
    """One for each survey, by name."""

    def with_status(self, *statuses: SurveyStatus) -> list[SurveyRow]:
        """Return the rows with one of these statuses."""
        return [row for row in self.rows if row.status in statuses]

    @property
    def exit_code(self) -> int:
        """0: all surveys are done. 4: some are. 3: none has layers."""
        good = self.with_status("done", "already done")
        if len(good) == len(self.rows):
            return 0
        return 4 if good or self.with_status("incomplete") else 3


def run_batch(
    config: BatchConfig,
    report: BatchReport | None = None,
    begin: Callable[[int], None] | None = None,
    spell: Callable[[str], str] = str,
) -> BatchResult:
    """Map many surveys, each to a folder of its own in ``config.out``.

    A survey that is done, by inputs, settings and versions, is left as it is; one whose run was interrupted is
    continued; one that fails is noted. A batch that was ended at any moment is continued by the same call. ``report``:
    receives the row of each survey when it has ended; ``begin``: receives the number of surveys before the first
    begins; ``spell``: changes messages before they are written, as `as_options` of the command line does. Raises
    BadInputError: the source holds no surveys; UsageError: settings or rows of a CSV that are not allowed; nothing was
    begun; OutputError: ``config.out`` cannot be written, is in use, or holds files of something else.
    """
    faults = partial(settings_faults, calibration=cache(find_calibration), header=cache(page_header))
    refuse_faults(faults(config.merged({}), complete=False), "settings for all surveys", UsageError)
    surveys = list_surveys(config.source, config.survey_per, lambda own: faults(config.merged(own)))
    (tasks, jobs), folder = _tasks(config, surveys), config.out
    if (scheduler := tasks[0].config.scheduler) is not None:
        with connect(scheduler):  # if it does not answer, each survey would wait for it
            pass
    check_batch_out(folder)
    if begin is not None:
        begin(len(surveys))
    with remove_empty_on_error(folder), locked(folder):
        results = Results(tasks, folder)
        try:
            with closing(map_tasks(tasks, jobs)) as ends:
                for found, trace in ends:
                    warnings = tuple(spell(warning) for warning in found.warnings)
                    row = replace(found, message=spell(found.message), warnings=warnings)
                    _note(row, trace)
                    results.add(row)
                    if report is not None:
                        report(row)
        finally:
            results.write_last()
    return BatchResult(results.rows)


def _tasks(config: BatchConfig, surveys: Sequence[Row]) -> tuple[list[MapTask], int]:
    """Return the surveys to map, and how many at a time.

    They are in the order of their names, or, if several run at a time, the largest first, so that none is left alone.
    """
    sizes, holder = [_size(place) for place, _, _ in surveys], lock_holder()
    jobs = config.jobs_for(sizes)
    tasks = [
        MapTask(name, config.share(config.of_survey(own, (place,), name), jobs), holder) for place, name, own in surveys
    ]
    if jobs > 1:
        tasks = [tasks[place] for place in sorted(range(len(tasks)), key=lambda place: -sizes[place])]
    return tasks, jobs


def _size(place: Path) -> int:
    """Return the bytes of a file or of those in a folder; 0 if that is not known."""
    with suppress(OSError):
        files = place.rglob("*") if place.is_dir() else [place]
        return sum(file.stat().st_size for file in files if file.is_file())
    return 0


def _note(row: SurveyRow, trace: str) -> None:
    """Log what is wrong with a survey; the trace of an unexpected error is an event of ``--json``."""
    if trace:
        _log.info("%s: %s", row.name, trace)
    for warning in row.warnings:
        _log.warning("%s: %s", row.name, warning)
    if row.status in {"failed", "incomplete"}:
        _log.warning("%s %s: %s", row.name, "failed" if row.status == "failed" else "is incomplete", row.message)


class BatchSettings(MapSettings, total=False):
    """Settings of `map_batch`: those of ``BatchConfig``, and of ``MapConfig`` for each survey."""

    survey_per: SurveyPer
    jobs: int | None


def map_batch(
    source: PathLike,
    out: PathLike,
    report: Callable[[SurveyRow], None] | None = None,
    **settings: Unpack[BatchSettings],
) -> BatchResult:
    """Map many surveys, each to a folder of its own, as ``bumpymap batch`` does.

    The same call again skips what is done, continues what was interrupted and tries again what has failed. A survey
    that fails raises nothing: its row says why.

    Parameters
    ----------
    source : path
        A folder of surveys; a ``.txt`` file with a path in each line; or a ``.csv`` file with the column ``survey``.
    out : path
        Gets a folder of layers for each survey, the summary and index.html.
    report : callable, optional
        Called with the `SurveyRow` of each survey when it has ended.
    **settings
        ``survey_per`` and ``jobs``, and those of `map_survey` for all surveys. They override the
        columns of a CSV.

    Returns
    -------
    BatchResult
        ``rows``: one for each survey, by name, with the columns of summary.csv. ``exit_code``: that of the command:
        0 all are done, 4 some are, 3 none.

    Raises
    ------
    BumpymapError
        The source holds no surveys, a setting is not allowed, or ``out`` cannot be used.

    Examples
    --------
    >>> import bumpymap
    >>> night = bumpymap.map_batch("sample_data", "night", ground="all")
    >>> [(row.name, row.status) for row in night.rows]
    [('quarry', 'done'), ('quarry_part', 'failed')]
    >>> night.exit_code
    4
    """
    given: dict[str, Any] = {**settings}
    own = {name: given.pop(name) for name in ("survey_per", "jobs") if given.get(name) is not None}
    if report is not None and not callable(report):
        raise UsageError(f"report is {short_repr(report)}; it must be a function that takes a row")
    places = Path(path_of_call("source", source)), Path(path_of_call("out", out))
    config = BatchConfig(*places, map_settings(given, "map_batch", BatchSettings.__annotations__), **own)
    return run_batch(config, report)
