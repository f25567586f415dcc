"""Find the surveys of a batch: in a folder, in a list of paths, or in the rows of a CSV."""

import logging
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bumpymap.core import BadInputError, UsageError, path_fault, read_regular, refuse_faults
from bumpymap.readers import find_surveys
from bumpymap.survey.batch.names import name_surveys, usual_name
from bumpymap.survey.batch.settings import SurveyPer
from bumpymap.survey.batch.table import read_table

__all__ = ["ListedSurvey", "list_surveys", "read_text"]

_log = logging.getLogger(__name__)
_LISTS = (".txt", ".csv")


@dataclass(frozen=True, slots=True)
class ListedSurvey:
    """A survey of a batch."""

    name: str
    """Folder of its layers."""
    place: Path | str
    """Its file, its folder, or a URL. Absolute, so that a batch started from another folder has the same inputs."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Its own settings, of a CSV."""
    renamed: bool = False
    """Whether another survey has, or could have, the name that it would get."""


def list_surveys(
    source: Path, survey_per: SurveyPer, check: Callable[[Mapping[str, Any]], list[str]] = lambda _: []
) -> list[ListedSurvey]:
    """Return the surveys of a batch by name.

    Parameters
    ----------
    source : Path
    survey_per : {"file", "folder"}
    check : callable, optional
        Returns what is wrong with the settings of a row of a table.

    Raises
    ------
    BadInputError
        The source does not exist or holds no surveys.
    UsageError
        A list with faults, all of which the message names.
    """
    if source.is_dir():
        places = _folders(source) if survey_per == "folder" else find_surveys([source.absolute()])
        rows: list[tuple[Path | str, str | None, dict[str, Any]]] = [(place, None, {}) for place in places]
    else:
        rows = _listed(source, check)
    root = _absolute(source if source.is_dir() else source.parent)
    places = [place if isinstance(place, str) else _absolute(place) for place, _, _ in rows]
    _refuse_repeated(places, source)
    names = name_surveys(places, [name for _, name, _ in rows], root)
    found = [
        ListedSurvey(name, place, own, renamed=given is None and name != usual_name(place))
        for name, place, (_, given, own) in zip(names, places, rows, strict=True)
    ]
    return sorted(found, key=lambda survey: survey.name)


def read_text(path: Path) -> str:
    """Return the text of a list; bytes that are not UTF-8 are kept, since they may be those of a file name."""
    try:
        return read_regular(path).decode("utf-8-sig", "surrogateescape")
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}") from error


def _listed(
    source: Path, check: Callable[[Mapping[str, Any]], list[str]]
) -> list[tuple[Path | str, str | None, dict[str, Any]]]:
    if not source.exists():
        raise BadInputError(f"{source} does not exist; name a folder of surveys, or a list of them (.txt or .csv)")
    suffix = source.suffix.lower()
    if suffix not in _LISTS or not source.is_file():
        raise UsageError(
            f"{source} is neither a folder nor a list ({' or '.join(_LISTS)}); a single survey is mapped by "
            "`bumpymap map`"
        )
    folder = _absolute(source.parent)
    if suffix == ".csv":
        found = read_table(read_text(source), str(source), folder, check)
    else:
        lines = [line.strip() for line in read_text(source).splitlines()]
        wanted = [(number, line) for number, line in enumerate(lines, 1) if line and not line.startswith("#")]
        faults = [f"line {number}: {why}" for number, line in wanted if (why := path_fault(line))]
        refuse_faults(faults, str(source), UsageError)
        found = [(line if "://" in line else folder / line, None, {}) for _, line in wanted]
    if not found:
        raise BadInputError(f"{source} names no survey")
    return found


def _folders(source: Path) -> list[Path | str]:
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


def _refuse_repeated(places: Sequence[Path | str], source: Path) -> None:
    repeated = [place for place, times in Counter(map(str, places)).items() if times > 1]
    refuse_faults([f"{place} is listed twice" for place in repeated], str(source), UsageError)
