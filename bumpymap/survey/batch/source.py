"""Find the surveys of a batch, in a folder, in a list of paths or in the rows of a CSV, and name their folders."""

import csv
import io
import logging
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain, count
from pathlib import Path
from typing import Any, get_origin

from bumpymap.core import (
    CLASHES,
    BadInputError,
    BumpymapError,
    MapConfig,
    NameOrFile,
    PageSettings,
    UsageError,
    parse_crs,
    parse_record,
    path_fault,
    read_regular,
    refuse_clashes,
    refuse_faults,
    settings_with_options,
    unknown_text,
    value_of_text,
    with_pixels,
)
from bumpymap.layers import BATCH_NAMES
from bumpymap.rating import Calibration
from bumpymap.readers import find_surveys
from bumpymap.survey.batch.settings import OWN_SETTINGS, SurveyPer

_log = logging.getLogger(__name__)
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
