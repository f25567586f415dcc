"""The files of a check, and what it found as plain JSON and back. Nothing here needs GDAL, which is slow to import."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    CLASS_NAMES,
    NO_CLASS,
    BadInputError,
    CheckedDrive,
    CheckedMap,
    CheckResult,
    DrivenStretches,
    MapAgreement,
    UsageError,
    parse_json,
    read_regular,
)
from bumpymap.layers.manifest import plain_manifest
from bumpymap.layers.products import OTHER_FILES, OutputFolder

__all__ = [
    "CHECK_FILES",
    "CHECK_FORMAT",
    "CHECK_MANIFEST_NAME",
    "check_check_out",
    "check_entries",
    "read_check",
    "result_of",
]

CHECK_MANIFEST_NAME = "check.json"
CHECK_FILES = OutputFolder(
    ("check.html", "check.geojson", CHECK_MANIFEST_NAME, "check.qml"),
    CHECK_MANIFEST_NAME,
    views=("check.qml",),
)


def check_check_out(out: Path, *, overwrite: bool) -> None:
    """Check, before anything is computed, that the files of a check can be written to a folder. Writes nothing.

    Raises
    ------
    UsageError
        ``out`` holds the layers of a survey, or is named like a file.
    OutputError
        There are files that must not be replaced, or ``out`` is a file.
    """
    if out.suffix.lower() in OTHER_FILES and not out.is_dir():
        raise UsageError(f"{out} is named like a {out.suffix.lower()} file, but a check is a folder. Give one as `out`")
    CHECK_FILES.check(out, overwrite=overwrite)


CHECK_FORMAT = "bumpymap-check"
_Record = TypeVar("_Record", CheckedDrive, CheckedMap, MapAgreement)
_CLASSES = {"class_id", "measured_class"}
_OF_MAP = ("c_r", "c_r_low", "c_r_high", "place_sd", "class_id")
"""Columns that hold what the map says of stretches."""
_MOST = 1e12
"""Largest number that a check may hold: no length, angle or time of a drive comes near it."""
_REMEDY = "Give the folder that `bumpymap check` wrote, as `check`"


def check_entries(result: CheckResult) -> dict[str, Any]:
    """Return the entries of check.json that hold the findings, as plain JSON: what is not known is null.

    Arrays become lists of numbers, one for each stretch; `result_of` is the way back.
    """
    found: dict[str, Any] = {
        "map": result.ground,
        "warnings": result.warnings,
        "skipped": result.skipped,
        "agreement": result.agreement,
        "by_class": [
            {"class": code, "name": CLASS_NAMES[code]} | _entries(agreement)
            for code, agreement in sorted(result.by_class.items())
        ],
        "drives": [_entries(drive) for drive in result.drives],
        "stretches": _columns(result.stretches),
        "line": None,
    }
    if result.by_line is not None:
        columns = _columns(result.by_line)
        found["line"] = {
            "agreement": result.agreement_by_line,
            "stretches": {name: columns[name] for name in _OF_MAP},
        }
    return plain_manifest(found)


def read_check(folder: Path) -> tuple[CheckResult, dict[str, Any]]:
    """Read the findings in a folder, or in check.json itself, and all that check.json holds.

    Raises
    ------
    BadInputError
        There is no check.json, or it is not one of `bumpymap check`.
    """
    path = folder / CHECK_MANIFEST_NAME if folder.is_dir() else folder
    if not path.is_file():
        raise BadInputError(f"there is no file {path}. {_REMEDY}")
    try:
        record = parse_json(read_regular(path).decode())
        if not isinstance(record, dict) or record.get("format") != CHECK_FORMAT:
            raise BadInputError(f"{path} is not that of a check. {_REMEDY}")
        return result_of(record), record
    except (OSError, ValueError, OverflowError, KeyError, TypeError, AttributeError) as error:
        raise BadInputError(f"cannot read {path} as a check: {error!r}. {_REMEDY}") from error


def result_of(record: Mapping[str, Any]) -> CheckResult:
    """Return the findings that `check_entries` wrote; ValueError, OverflowError, KeyError or TypeError if damaged."""
    ground, whole = record["map"], record["agreement"]
    stretches = DrivenStretches(**_arrays(DrivenStretches, record["stretches"]))
    drives = tuple(_read(CheckedDrive, entry) for entry in record["drives"])
    if len(stretches.drive) and not 0 <= stretches.drive.min() <= stretches.drive.max() < len(drives):
        raise ValueError("a stretch belongs to no drive")
    line, by_line = record.get("line"), None
    if line is not None:
        by_line = DrivenStretches(**_arrays(DrivenStretches, {**record["stretches"], **line["stretches"]}))
    return CheckResult(
        ground=None if ground is None else _read(CheckedMap, ground),
        drives=drives,
        stretches=stretches,
        agreement=None if whole is None else _read(MapAgreement, whole),
        by_class={_class_of(entry["class"]): _read(MapAgreement, entry) for entry in record["by_class"]},
        warnings=_texts(record["warnings"]),
        skipped={str(drive): str(why) for drive, why in record.get("skipped", {}).items()},
        by_line=by_line,
        agreement_by_line=None if line is None else _read(MapAgreement, line["agreement"]),
    )


def _entries(record: Any) -> dict[str, Any]:
    return {field.name: getattr(record, field.name) for field in fields(record)}


def _columns(record: Any) -> dict[str, list[Any]]:
    """Return the arrays of a record as lists; no class is None."""
    found = {name: values.tolist() for name, values in _entries(record).items()}
    for name in _CLASSES & set(found):
        found[name] = [None if code == NO_CLASS else code for code in found[name]]
    return found


def _arrays(kind: Any, columns: Mapping[str, Sequence[Any]]) -> dict[str, NDArray[Any]]:
    found: dict[str, NDArray[Any]] = {}
    for field in fields(kind):
        values = columns[field.name]
        if field.name in _CLASSES:
            codes = [NO_CLASS if code is None else _class_of(code) for code in values]
            found[field.name] = np.array(codes, np.uint8)
        elif field.name == "drive":
            found[field.name] = np.array(values, np.int64)
        else:
            found[field.name] = np.array(values, np.float64)  # None becomes NaN
    if len({array.shape for array in found.values()}) > 1 or any(array.ndim != 1 for array in found.values()):
        raise ValueError("columns differ in length")
    if any((np.abs(array) > _MOST).any() for array in found.values()):
        raise ValueError(f"a number is larger than {_MOST:g}")
    return found


def _class_of(code: Any) -> int:
    return range(len(CLASS_NAMES)).index(code)


def _number(value: Any) -> float:
    number = float("nan") if value is None else float(value)
    if abs(number) > _MOST:
        raise ValueError(f"{value} is larger than {_MOST:g}")
    return number


def _texts(values: Sequence[Any]) -> tuple[str, ...]:
    if not isinstance(values, Sequence) or isinstance(values, str):
        raise TypeError(f"{values!r} is no list of texts")
    return tuple(map(str, values))


def _three(values: Sequence[Any]) -> tuple[float, float, float]:
    first, second, third = map(_number, values)
    return first, second, third


_READ: dict[Any, Callable[[Any], Any]] = {
    str: str,
    int: int,
    float: _number,
    Path: Path,
    tuple[float, float, float]: _three,
    tuple[str, ...]: _texts,
    tuple[Path, ...]: lambda paths: tuple(map(Path, paths)),
    Mapping[str, float]: lambda entry: {str(name): _number(value) for name, value in entry.items()},
    Mapping[str, str]: lambda entry: {str(name): str(value) for name, value in entry.items()},
}
"""How plain JSON becomes each type that a field may have."""


def _read(kind: type[_Record], entry: Mapping[str, Any]) -> _Record:
    return kind(**{field.name: _READ[field.type](entry[field.name]) for field in fields(kind)})
