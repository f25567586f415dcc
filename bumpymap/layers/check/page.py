"""Write check.md: what drives say of a map, to read and to send."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from bumpymap.core import CheckResult, atomic
from bumpymap.layers.check.tables import (
    AGREEMENT_HEAD,
    WORST_HEAD,
    agreement_rows,
    drive_notes,
    drive_rows,
    left_out_rows,
    warnings_of,
    worst_rows,
)
from bumpymap.layers.check.words import FEW, check_headline, names_of

__all__ = ["check_page", "write_check_page"]

_READ = """\
Ride cost C_r is pitch motion per metre driven, rad/m. Each drive is cut into stretches; on each, the C_r that the IMU
measured, less what it reads at standstill, stands beside that of the map over the same ground."""
_READ_FIGURES = """\
- **map / drive** is the ratio of both: under 1, the ground is rougher for this vehicle than the map says. Its median
  over many stretches says whether the level of the map fits this vehicle. A level that is off alike on all classes is
  one number to correct; one that differs by class says that smooth and rough ground are off in different ways.
- **error** is the median of the absolute difference of that ratio from 1.
- **Spearman** is the correlation of ranks: at 1 the map puts all stretches in the order in which the vehicle felt
  them. Planning routes needs this more than the level. Where all ground is alike it says little.
- **in the 80 % interval** is the share of stretches whose measurement lies in the map's interval, widened by the error
  of the measurement. 80 % is right; far less means that the map is surer than it may be.
- A stretch is listed as off only if neither the map's interval nor the errors of measurement and position explain the
  difference. If all is as it should be, that happens on one stretch in five."""
_FILES = {
    "check.png": "the map with the stretches on it, map against drive, and both along the way",
    "check.geojson": "the stretches, for QGIS and other GIS; QGIS takes its style from check.qml",
    "check_tiles.geojson": "the tiles that were driven over, likewise",
    "stretches.csv": "the stretches as a table",
    "check.json": "all of it, with settings, versions and checksums",
}


def write_check_page(result: CheckResult, names: Iterable[str], path: Path) -> None:
    """Write the page.

    Parameters
    ----------
    result : CheckResult
    names : iterable of str
        The files beside it.
    path : Path
        The file, which appears only when it is complete.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    text = check_page(result, names)
    with atomic(path) as temporary:
        temporary.write_bytes(text.encode("utf-8", "backslashreplace"))


def check_page(result: CheckResult, names: Iterable[str]) -> str:
    """Return the page as Markdown; ``names`` are the files beside it."""
    ground = result.ground
    drives = names_of([drive.name for drive in result.drives])
    title = f"Drives measured: {drives}" if ground is None else f"{ground.name} checked against {drives}"
    parts = [f"# {_plain(title)}", _plain(check_headline(result))]
    if ground is not None:
        limits = ", ".join(f"{limit:.3g}" for limit in ground.class_limits)
        parts.append(
            f"Map: vehicle {_plain(ground.vehicle)}, calibration {_plain(ground.calibration_id)}, driven at "
            f"{ground.speed_mps:g} m/s, limits of the classes {limits} rad/m."
        )
    parts += _section("Warnings", _list(map(_plain, warnings_of(result))))
    parts += _section("Map against drives", _table(AGREEMENT_HEAD, agreement_rows(result)))
    parts += _section("Where the map is off", *_off(result))
    parts += _section(
        "The drives",
        _table(("", *_drive_names(result)), drive_rows(result.drives)),
        _list(map(_plain, drive_notes(result))),
    )
    parts += _section("What does not count", _table(("why", "way"), left_out_rows(result)))
    parts += _section("How to read this", _READ, _READ_FIGURES if result.agreement is not None else "")
    parts += _section("Files", _list(f"`{name}`: {text}" for name, text in _FILES.items() if name in set(names)))
    return "\n\n".join(parts) + "\n"


def _off(result: CheckResult) -> list[str]:
    if result.agreement is None or result.agreement.stretches < FEW:
        return []
    rows = worst_rows(result)
    if not rows:
        return ["On no stretch more than the map's interval and the errors of measurement explain."]
    return ["Farthest beyond what the map's interval and the errors of measurement explain:", _table(WORST_HEAD, rows)]


def _drive_names(result: CheckResult) -> list[str]:
    return [drive.name for drive in result.drives]


def _section(title: str, *parts: str) -> list[str]:
    found = [part for part in parts if part]
    return [f"## {title}", *found] if found else []


def _list(items: Iterable[str]) -> str:
    return "\n".join(f"- {item}" for item in items)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    if not rows:
        return ""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(_cell, line))} |" for line in lines)


def _cell(text: str) -> str:
    return text if text == "---" else _plain(text).replace("|", "\\|")


def _plain(text: str) -> str:
    """Return text without line breaks, with what Markdown would take for marks or HTML made harmless."""
    one_line = " ".join(text.split())
    return "".join(f"\\{letter}" if letter in "\\`*<[" else letter for letter in one_line)
