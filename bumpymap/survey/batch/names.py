"""Names of the folders that the layers of surveys are written to."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from urllib.parse import urlsplit

from bumpymap.layers import BATCH_NAMES

__all__ = ["name_surveys", "plain_name", "usual_name"]

_TWO_PARTS = ".copc"
"""Of ``site.copc.laz``, which is the survey ``site``."""


def name_surveys(surveys: Sequence[Path | str], given: Sequence[str | None], root: Path) -> list[str]:
    """Return a folder name for each survey; no two are the same, even where upper and lower case are.

    A survey is named after its file without the suffix. Those of one name get the names of their folders too
    (``north_site``, ``south_site``), those of one folder their suffix (``site_las``), and what is left a number.

    Parameters
    ----------
    surveys : sequence of Path or str
        File, folder or URL of each.
    given : sequence of str or None
        Names that the user chose, which are kept.
    root : Path
        Folders below this one count for a name.
    """
    parts = [_parts(_path(survey), root) for survey in surveys]
    usual = [usual_name(survey) for survey in surveys]
    longer = ["_".join([*own[:-1], name]) for own, name in zip(parts, usual, strict=True)]
    whole = [f"{name}_{_path(survey).suffix[1:]}" for name, survey in zip(longer, surveys, strict=True)]
    names = [own or name for own, name in zip(given, usual, strict=True)]
    for candidates in (longer, whole):
        taken = Counter(name.casefold() for name in names)
        names = [
            name if own or (taken[name.casefold()] == 1 and not _is_reserved(name)) else _clean(candidate)
            for name, own, candidate in zip(names, given, candidates, strict=True)
        ]
    return _numbered(names, given)


def usual_name(survey: Path | str) -> str:
    """Return the name of a survey that shares it with no other: that of its file without the suffix, or its folder."""
    path = _path(survey)
    return _clean(path.name if isinstance(path, Path) and path.is_dir() else _stem(path))


def plain_name(name: str) -> str:
    """Return what is wrong with a name that a user gave; empty if it can be that of a folder."""
    if "/" in name or "\0" in name or name.startswith(".") or _is_reserved(name):
        return "it must be the name of a folder: no slash, no dot at its start, no name of a file of the batch"
    return ""


def _numbered(names: list[str], given: Sequence[str | None]) -> list[str]:
    """Append numbers to names that are still taken, or not allowed."""
    used = {name.casefold() for name, own in zip(names, given, strict=True) if own}
    for place, name in enumerate(names):
        if given[place]:
            continue
        free, number = name, 2
        while free.casefold() in used or _is_reserved(free):
            free, number = f"{name}_{number}", number + 1
        used.add(free.casefold())
        names[place] = free
    return names


def _path(survey: Path | str) -> PurePosixPath | Path:
    """Return the path of a survey; of a URL without user and query, which may hold a key."""
    if isinstance(survey, Path):
        return survey
    parts = urlsplit(survey)
    return PurePosixPath(f"{parts.netloc.rpartition('@')[2]}{parts.path}")


def _parts(path: PurePosixPath | Path, root: Path) -> tuple[str, ...]:
    try:
        return path.relative_to(root).parts
    except ValueError:
        return path.parts[-2:]


def _stem(path: PurePosixPath | Path) -> str:
    stem = path.stem
    return stem[: -len(_TWO_PARTS)] if stem.lower().endswith(_TWO_PARTS) else stem


def _clean(name: str) -> str:
    """Return a name that is not hidden and not empty."""
    return name.strip().lstrip(".") or "survey"


def _is_reserved(name: str) -> bool:
    return name.casefold() in {*BATCH_NAMES, "run.json"}
