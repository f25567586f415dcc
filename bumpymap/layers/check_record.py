"""The files of a check, and what it found as plain JSON. Nothing here needs GDAL, which is slow to import."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from bumpymap.core import CLASS_NAMES, NO_CLASS, CheckResult, DrivenStretches, UsageError, plain_json
from bumpymap.layers.products import OTHER_FILES, MapFile, OutputFolder

CHECK_MANIFEST_NAME = "check.json"
CHECK_FILES = OutputFolder(
    ("check.html", "check.geojson", CHECK_MANIFEST_NAME, "check.qml", MapFile.PROJECT),
    CHECK_MANIFEST_NAME,
    views=("check.qml", MapFile.PROJECT),
)


def check_check_out(out: Path, *, overwrite: bool) -> None:
    """Check, before anything is computed, that the files of a check can be written to a folder. Writes nothing.

    Raises UsageError: ``out`` holds the layers of a survey, or is named like a file; OutputError: there are files that
    must not be replaced, or ``out`` is a file.
    """
    if out.suffix.lower() in OTHER_FILES and not out.is_dir():
        raise UsageError(f"{out} is named like a {out.suffix.lower()} file, but a check is a folder. Give one as `out`")
    CHECK_FILES.check(out, overwrite=overwrite)


CHECK_FORMAT = "bumpymap-check"
_CLASSES = {"class_id", "measured_class"}
_OF_MAP = ("c_r", "c_r_low", "c_r_high", "place_sd", "class_id")
"""Columns that hold what the map says of stretches."""


def check_entries(result: CheckResult) -> dict[str, Any]:
    """Return the entries of check.json that hold the findings, as plain JSON: what is not known is null.

    Arrays become lists of numbers, one for each stretch.
    """
    found: dict[str, Any] = {
        "map": result.ground,
        "warnings": result.warnings,
        "skipped": result.skipped,
        "agreement": result.agreement,
        "by_class": [
            {"class": code, "name": CLASS_NAMES[code]} | asdict(agreement)
            for code, agreement in sorted(result.by_class.items())
        ],
        "drives": result.drives,
        "stretches": _columns(result.stretches),
        "line": None,
    }
    if result.by_line is not None:
        columns = _columns(result.by_line)
        found["line"] = {"agreement": result.agreement_by_line, "stretches": {name: columns[name] for name in _OF_MAP}}
    record: dict[str, Any] = plain_json(found)
    return record


def _columns(record: DrivenStretches) -> dict[str, list[Any]]:
    """Return the arrays of a record as lists; no class is None."""
    found = {name: values.tolist() for name, values in asdict(record).items()}
    for name in _CLASSES & set(found):
        found[name] = [None if code == NO_CLASS else code for code in found[name]]
    return found
