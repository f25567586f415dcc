"""Numbers as pages show them, and texts that take more than a template: names, degrees, a check in words."""

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING, Any

import numpy as np

from bumpymap.core import CLASS_NAMES, NORMAL_80, SeenSizes, count_text, parse_json, share_text, shares_text
from bumpymap.layers import ISLAND_M2

if TYPE_CHECKING:
    from bumpymap.core import CheckedDrive, CheckResult, DrivenStretches, MapAgreement
    from bumpymap.layers import ZoneCounts

DASH = "\N{EN DASH}"
"""Stands where nothing is known."""
PERCENT = "\N{NO-BREAK SPACE}%"
_SQUARE_KILOMETRE, _HECTARE = 1e6, 1e4
"""m2."""


def number(value: Any, decimals: int, unit: str = "") -> str:
    """Return a number with its unit; a dash if it is not known."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return DASH
    return f"{value:,.{decimals}f}{unit}"


def whole(value: int) -> str:
    """Return a whole number with its thousands apart."""
    return f"{value:,}"


def share(part: float, total: float, percent: str = PERCENT) -> str:
    """Return a share in per cent; small shares are not rounded to nothing, nor large ones to all."""
    return share_text(part / total, percent=percent) if total else DASH


def shares(counts: Sequence[float], alone: Collection[int] = ()) -> list[str]:
    """Return the shares of all parts of a whole, which make 100 % together; see `shares_text`."""
    return shares_text(counts, alone, percent=PERCENT) if sum(counts) else [DASH] * len(counts)


def area(square_metres: float, among: float | None = None) -> str:
    """Return an area in m2, ha or km2; in the one unit of a column, m2 or ha, given its largest with ``among``."""
    if among is not None:
        if among < _SQUARE_KILOMETRE:
            return f"{square_metres:,.0f} m²"
        return f"{square_metres / _HECTARE:,.2f} ha" if square_metres >= 50.0 or not square_metres else "under 0.01 ha"
    if square_metres >= _SQUARE_KILOMETRE:
        return f"{square_metres / _SQUARE_KILOMETRE:,.2f} km²"
    if square_metres >= _HECTARE:
        return f"{square_metres / _HECTARE:,.2f} ha"
    return f"{square_metres:,.0f} m²"


def signed(value: Any, decimals: int) -> str:
    """Return a difference with its sign."""
    text = number(value, decimals)
    if text == DASH or not text.strip("-0."):
        return text.removeprefix("-")
    return f"+{text}" if value > 0 else text


def degrees(radians: float) -> str:
    """Return an angle in radians as degrees."""
    return f"{math.degrees(radians):.1f}"


_FILE = Path(__file__).with_name("page") / "data" / "surfaces.json"
_NAMED = ("asphalt", "snow", "silty loam")
"""Surfaces in a line of a summary, which everyone has walked on."""


def read_surfaces() -> dict[str, Any]:
    """Read the C_r that one real vehicle measured on named surfaces, from the file that comes with the package.

    Returns ``vehicle``, ``kind``, ``speed``, ``source`` and ``method`` in words; ``floor``, rad/m: what the vehicle
    itself gives on even ground, from and to; ``c_r``: surface -> rad/m, rising.
    """
    known: dict[str, Any] = parse_json(_FILE.read_text(encoding="utf-8"))
    rising = sorted(known.pop("surfaces"), key=lambda one: float(one["c_r"]))
    return known | {"c_r": {str(one["name"]): float(one["c_r"]) for one in rising}}


def degrees_line(median_c_r: Sequence[float]) -> str:
    """Say in degrees of pitch per metre what classes cost, beside named surfaces.

    ``median_c_r``: of each class, rad/m; NaN without tiles.
    """
    known = zip(CLASS_NAMES, median_c_r, strict=False)
    classes = ", ".join(f"{name} {degrees(c_r)}" for name, c_r in known if math.isfinite(c_r))
    if not classes:
        return ""
    real = read_surfaces()
    named = ", ".join(f"{degrees(real['c_r'][name])} on {name}" for name in _NAMED)
    return f"Median c_r in degrees of pitch per metre: {classes}; a real {real['vehicle']} measured {named}"


def zones_line(zones: "ZoneCounts", percent: str = PERCENT) -> str:
    """Say which share of the passable ground hangs together, and how much of it lies on islands; empty without any."""
    if not zones.largest_tiles:
        return ""
    largest = f"in one piece of {area(zones.largest_m2)}"
    line = f"{share_text(zones.largest_share, percent=percent)} of what can be crossed hangs together {largest}"
    islands = count_text(zones.island_tiles, "tile lies on an island", "tiles lie on islands")
    return f"{line}; {islands} under {area(ISLAND_M2)}" if zones.island_tiles else line


def base_name(path: str) -> str:
    """Return the last part of a path or URL: folders are private."""
    return PurePosixPath(PureWindowsPath(path.partition("?")[0]).as_posix()).name or path


def seen_sizes(record: Mapping[str, Any]) -> SeenSizes:
    """Return what the survey of a map would have shown in the median tile, by its run.json."""
    return SeenSizes.of(record.get("counts", {}).get("seen_sizes") or {})


FEW = 5
"""Fewer stretches on the map say nothing about it: chosen, as the next ones."""
LEVEL = 1.15
"""Up to this factor of its median ratio from 1 a map holds."""
INSIDE = 0.8
"""Share of readings that the map's interval should hold; with fewer the map is surer than it may be."""
RANKS, ROUGHLY = 0.8, 0.5
"""From these Spearman correlations on a map ranks ground rightly, and roughly."""
EVEN = 1.5
"""Ground is too even to rank if its 90 % quantile is less than this factor above its 10 % quantile."""


def volumes_text(volumes: Mapping[str, float]) -> str:
    """Return what was heaped up and dug, with the error of 80 %; empty if nothing was. See `change.json`."""
    parts = [
        f"{volumes[f'{name}_m3']:,.1f} ± {NORMAL_80 * volumes[f'{name}_sd_m3']:,.1f} m³ {words}"
        for name, words in (("heaped", "heaped up"), ("dug", "dug"))
        if volumes[f"{name}_m3"] > 0.0
    ]
    return " and ".join(parts)


def least_volume_text(volumes: Sequence[float | None] | None) -> str:
    """Return the smallest heap and pit that would be found on half and on nine tenths of the ground, in words.

    ``volumes``: m3; None where a heap on one tile is not found, however large: only two tiles together are.
    """
    if volumes is None:
        return ""
    half, most = (None if volume is None else f"{volume:.2g} m³" for volume in volumes)
    if half is None:
        return "too few pixels were seen to find a heap or pit on a single tile, however large, on half of the ground"
    rest = f"of {most} on nine tenths of it" if most else "on a tenth of it none on a single tile, however large"
    return f"a heap or pit of {half} on one tile would be found on half of the ground, {rest}"


def check_headline(result: "CheckResult") -> list[str]:
    """Return the result in a few sentences: whether the map holds by the driven line, if known, and by its tiles."""
    if result.agreement is None:
        measured, lengths = result.stretches.measured, result.stretches.way_m
        known = np.isfinite(measured) & (lengths > 0.0)
        count = count_text(len(result.drives), "drive")
        if not known.any():
            return [f"Nothing was measured on {count}."]
        mean, way = float(np.average(measured[known], weights=lengths[known])), float(np.sum(lengths))
        return [f"{count} measured over {metres(way)}: a ride cost of {mean:.3f} rad/m on average. No map was checked."]
    judged = [("By its tiles, which are means over all headings", result.agreement, result.stretches)]
    if result.agreement_by_line is not None and result.by_line is not None:
        judged.insert(0, ("By the driven lines, rolled over its pixels", result.agreement_by_line, result.by_line))
    said = [f"{way}, {_judgement(found, stretches)}" for way, found, stretches in judged if found.stretches >= FEW]
    few = judged[0][1]
    over = f"{metres(few.way_m)} in {count_text(few.stretches, 'stretch', 'stretches')}"
    return said or [f"Too little was driven on the map to judge it: {over}. Drive at least {FEW} stretches of it."]


def _judgement(agreement: "MapAgreement", stretches: "DrivenStretches") -> str:
    return (
        f"{check_verdict(agreement, stretches)}: over {metres(agreement.way_m)} in "
        f"{count_text(agreement.stretches, 'stretch', 'stretches')} it {level_words(agreement)} in the median, half of "
        f"the stretches are off by less than {percent(agreement.median_error)}, {percent(agreement.inside)} of the "
        f"drives' readings lie in its 80 % interval, and the rank correlation is {number(agreement.spearman, 2)}."
    )


def check_verdict(agreement: "MapAgreement", stretches: "DrivenStretches") -> str:
    """Return whether the map holds, in words that the figures bear out as they are shown.

    ``stretches``: at least ``FEW``, with what the map says of them in the same way.
    """
    if not np.isfinite(agreement.median_ratio):
        return "the map cannot be judged"
    level, rank = 1 / LEVEL <= agreement.median_ratio <= LEVEL, agreement.spearman
    inside = round(agreement.inside, 2) >= INSIDE
    allowed = " by no more than its interval allows" if inside else ""
    known = stretches.measured[np.isfinite(stretches.c_r) & (stretches.measured > 0.0)]
    low, high = np.quantile(known, [0.1, 0.9]) if len(known) else (1.0, 1.0)
    if high < EVEN * low or not np.isfinite(rank):
        even = "the ground driven is too even to say whether the map ranks ground rightly"
        return f"the level of the map {'holds' if level else f'is off{allowed}'}; {even}"
    if round(rank, 2) >= RANKS:
        if level:
            return "the map holds" if inside else "the map holds in rank and level, but is surer than it may be"
        return f"the map ranks the ground rightly, but its level is off{allowed}"
    if round(rank, 2) >= ROUGHLY:
        return f"the map ranks the ground only roughly{'' if level else f', and its level is off{allowed}'}"
    return "the map does not rank this ground as the vehicle felt it"


def agreements_of(result: "CheckResult") -> "list[tuple[str, MapAgreement]]":
    """Return the agreement over all stretches, by the driven line and by tiles, and by class of the map, named."""
    whole = (("all, by the driven line", result.agreement_by_line), ("all, by tiles", result.agreement))
    by_class = [(f"{code} {CLASS_NAMES[code]}, by tiles", found) for code, found in sorted(result.by_class.items())]
    return [*((name, found) for name, found in whole if found is not None), *by_class]


def columns_words(drive: "CheckedDrive") -> list[str]:
    """Return which columns a drive was read from, and the quantity where its name differs, for each file."""
    found: dict[str, list[str]] = {}
    for quantity, column in drive.columns.items():
        place, separator, name = column.rpartition(": ")
        said = name if name.startswith(quantity) else f"{name} as {quantity}"
        found.setdefault(place if separator else "the log", []).append(said)
    return [f"read from {place}: {', '.join(columns)}" for place, columns in found.items()]


def level_words(agreement: "MapAgreement") -> str:
    """Return "reads 8 % low" for a median ratio of 0.92."""
    ratio = agreement.median_ratio
    if not np.isfinite(ratio):
        return "cannot be compared"
    if abs(ratio - 1.0) < 0.005:
        return "reads neither high nor low"
    if ratio > 2.0:
        return f"reads {ratio:.1f} times too high"
    return f"reads {percent(abs(ratio - 1.0))} {'high' if ratio > 1.0 else 'low'}"


def metres(length: float) -> str:
    """Return a length in m, or in km from 5 km on."""
    return f"{length:,.0f} m" if length < 5000.0 else f"{length / 1000:,.1f} km"


def percent(part: float) -> str:
    """Return a share in per cent without decimals; a dash if it is not known."""
    return f"{100 * part:.0f} %" if np.isfinite(part) else "\N{EN DASH}"


def warnings_of(result: "CheckResult") -> list[str]:
    """Return the warnings of the whole check and of each drive that counts, each once."""
    several = len(result.drives) > 1  # then each text names its drive
    own = [
        f"{drive.name}: {text}" if several and not text.startswith(drive.name) else text
        for drive in result.drives
        for text in drive.warnings
    ]
    return list(dict.fromkeys([*result.warnings, *own]))
