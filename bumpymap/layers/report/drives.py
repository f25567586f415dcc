"""Drives that a map was checked against: their section on its page, the page of a check, charts as inline SVG."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    CLASS_NAMES,
    NO_CLASS,
    BadInputError,
    CheckedDrive,
    CheckResult,
    DrivenStretches,
    MapAgreement,
    count_text,
)
from bumpymap.layers.check.offset import LogAxis, MapOffset
from bumpymap.layers.check.record import read_check
from bumpymap.layers.check.words import (
    drive_notes,
    metres,
    percent,
    skipped_words,
    sorted_reasons,
    warnings_of,
)
from bumpymap.layers.colours import OFF_COLOURS
from bumpymap.layers.manifest import MANIFEST_NAME, describe_file
from bumpymap.layers.report.markup import DASH, Html, join, lines_of, number, raw, table, tag

__all__ = ["DrawnCheck", "along_chart", "drive_chart", "drive_figures", "read_drawn_check", "reading_notes"]

_REMEDY = "Check this map, with `bumpymap check`, and give the folder as `check`"


@dataclass(frozen=True, slots=True)
class DrawnCheck:
    """What drives show of the map of a page."""

    result: CheckResult
    is_of_this_run: bool
    """False where the layers were written again since."""

    def places(self) -> list[dict[str, Any]]:
        """Return each stretch with a position as the script of the page needs it."""
        stretches, offset = self.result.stretches, MapOffset.of(self.result.stretches)
        known = np.isfinite(stretches.easting) & np.isfinite(stretches.northing)
        return [
            {
                "east": round(float(stretches.easting[at]), 2),
                "north": round(float(stretches.northing[at]), 2),
                "kind": int(offset.kind[at]),
                "off": bool(offset.is_off[at]),
                "text": self._text(at, float(offset.ratio[at])),
            }
            for at in np.flatnonzero(known).tolist()
        ]

    def _text(self, at: int, ratio: float) -> str:
        stretches = self.result.stretches
        name = self.result.drives[int(stretches.drive[at])].name
        text = f"{name} measured {stretches.measured[at]:.3f} rad/m"
        if not np.isfinite(ratio):
            return text
        level = f"{percent(abs(ratio - 1.0))} {'high' if ratio > 1.0 else 'low'}"
        return f"{text}, the map says {stretches.c_r[at]:.3f} along the stretch ({level})"


def read_drawn_check(check: Path, record: Mapping[str, Any], layers: Path) -> DrawnCheck:
    """Read the drives in a folder, or in check.json itself, for the page of a map.

    Parameters
    ----------
    check : Path
        What `bumpymap check` wrote.
    record : mapping
        The content of run.json of the map.
    layers : Path
        The folder of the map.

    Raises
    ------
    BadInputError
        There is no check.json, or it is that of another map, or of drives without a map.
    """
    result, found = read_check(check)
    if result.ground is None:
        raise BadInputError(f"the drives in {check} were measured without a map. {_REMEDY}")
    try:
        differences = _differences(result, found, record)
        runs = {str(entry["run_sha256"]) for entry in found.get("layers") or []}
    except (KeyError, TypeError, AttributeError) as error:
        raise BadInputError(f"cannot read {check} as a check: {error!r}. {_REMEDY}") from error
    if differences:
        raise BadInputError(f"{check} is the check of another map than {layers}: {'; '.join(differences)}. {_REMEDY}")
    is_same = bool(record.get("sheets")) or describe_file(layers / MANIFEST_NAME)["sha256"] in runs
    return DrawnCheck(result, is_same)


def _differences(result: CheckResult, found: Mapping[str, Any], record: Mapping[str, Any]) -> list[str]:
    calibration = record.get("calibration")
    own = calibration.get("id") if isinstance(calibration, Mapping) else calibration
    pairs: list[tuple[str, Any, Any]] = [("the calibration", result.ground and result.ground.calibration_id, own)]
    if "grid" in found:  # positions are known
        pairs.append(("the CRS", _crs(found), _crs(record)))
        pairs.append(("the size of tiles", found["grid"]["tile_size_m"], record["grid"]["tile_size_m"]))
    return [f"{what} is {there or 'none'} there, {here or 'none'} here" for what, there, here in pairs if there != here]


def _crs(record: Mapping[str, Any]) -> Any:
    crs = record.get("crs")
    return None if crs is None else crs.get("code") or crs["wkt"]


_WIDTH, _HEIGHT = 560, 440
_LEFT, _RIGHT, _TOP, _BOTTOM = 64, 12, 12, 48
_FACTOR = 1.5
"""Thin lines: map and drive differ by this factor."""
_NORMAL_80 = 1.2816
_TITLE = "Ride cost of the map and as the drives measured it"


def drive_chart(result: CheckResult, key: str) -> Html:
    """Return measured over predicted C_r, one mark a stretch; empty if nothing can be compared.

    Parameters
    ----------
    result : CheckResult
    key : str
        Makes ids on the page differ.
    """
    stretches, offset = result.stretches, MapOffset.of(result.stretches)
    shown = np.flatnonzero(np.isfinite(offset.ratio))
    if not len(shown):
        return Html()
    axis = LogAxis.around(np.concatenate([stretches.c_r[shown], stretches.measured[shown]]))
    limits = () if result.ground is None else result.ground.class_limits
    order = shown[np.argsort(offset.beyond[shown], kind="stable")]
    parts = [*_axes(axis, limits), *_bars(axis, stretches, shown), *_marks(axis, stretches, offset, order)]
    title = f"{_TITLE}: a mark for each of {count_text(len(shown), 'stretch', 'stretches')}"
    picture = _svg((_WIDTH, _HEIGHT), title, f"chart-{key}", parts)
    note = (
        ". One mark a stretch, both axes logarithmic. Grey bars: the map's 80 % interval, and the 80 % error of the "
        f"measurement. Thick line: both agree; thin lines: a factor of {_FACTOR:g}. Brown lines: limits of the classes."
    )
    return tag("figure", tag("figcaption", tag("strong", _TITLE), note), picture, class_="plot")


def _across(axis: LogAxis, values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(_LEFT + (_WIDTH - _LEFT - _RIGHT) * axis.part(values), dtype=np.float64)


def _up(axis: LogAxis, values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(_HEIGHT - _BOTTOM - (_HEIGHT - _TOP - _BOTTOM) * axis.part(values), dtype=np.float64)


def _axes(axis: LogAxis, limits: tuple[float, ...]) -> list[str]:
    right, foot, parts = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM, []
    lines = [(value, "#e2e4e8") for value in axis.ticks]
    lines += [(limit, "#c49678") for limit in limits if axis.low < limit < axis.high]
    for value, colour in lines:
        x, y = (float(place(axis, np.array([value]))[0]) for place in (_across, _up))
        parts.append(f'<path d="M{x:.1f} {_TOP}V{foot}M{_LEFT} {y:.1f}H{right}" stroke="{colour}"/>')
    for value in axis.ticks:
        x, y = (float(place(axis, np.array([value]))[0]) for place in (_across, _up))
        parts.append(f'<text x="{x:.1f}" y="{foot + 16}" text-anchor="middle">{value:g}</text>')
        parts.append(f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>')
    for factor, colour, width in ((1 / _FACTOR, "#6b7280", 1), (1.0, "#1f2937", 2), (_FACTOR, "#6b7280", 1)):
        ends = np.array([max(axis.low, axis.low / factor), min(axis.high, axis.high / factor)])
        (left, far), (low, high) = _across(axis, ends).tolist(), _up(axis, ends * factor).tolist()
        parts.append(f'<path d="M{left:.1f} {low:.1f}L{far:.1f} {high:.1f}" stroke="{colour}" stroke-width="{width}"/>')
    middle = (_LEFT + right) / 2
    parts.append(f'<text x="{middle}" y="{_HEIGHT - 8}" text-anchor="middle">C_r of the map, rad/m</text>')
    turned = f'transform="translate(16 {(_TOP + foot) / 2}) rotate(-90)"'
    parts.append(f'<text {turned} text-anchor="middle">C_r measured by the drive, rad/m</text>')
    return parts


def _bars(axis: LogAxis, stretches: DrivenStretches, shown: NDArray[np.int64]) -> list[str]:
    c_r, measured = stretches.c_r[shown], stretches.measured[shown]
    half = _NORMAL_80 * np.nan_to_num(stretches.measured_sd[shown])
    left, right = (
        _across(axis, np.where(np.isfinite(end), end, c_r))
        for end in (stretches.c_r_low[shown], stretches.c_r_high[shown])
    )
    x, y = _across(axis, c_r), _up(axis, measured)
    low, high = _up(axis, measured - half), _up(axis, measured + half)
    columns = (values.tolist() for values in (left, y, right, x, low, high))
    path = "".join(
        f"M{a:.1f} {b:.1f}H{c:.1f}M{d:.1f} {e:.1f}V{f:.1f}" for a, b, c, d, e, f in zip(*columns, strict=True)
    )
    return [f'<path d="{path}" stroke="#9aa0a8" fill="none"/>']


def _marks(axis: LogAxis, stretches: DrivenStretches, offset: MapOffset, order: NDArray[np.int64]) -> list[str]:
    x, y = _across(axis, stretches.c_r[order]).tolist(), _up(axis, stretches.measured[order]).tolist()
    return _discs(x, y, offset, order)


def _discs(x: list[float], y: list[float], offset: MapOffset, order: NDArray[np.int64], size: float = 1.0) -> list[str]:
    """Return the marks of stretches: larger where errors do not explain how far the map is off."""
    marks = zip(x, y, offset.kind[order].tolist(), offset.is_off[order].tolist(), strict=True)
    return [
        f'<circle cx="{at:.1f}" cy="{up:.1f}" r="{(5.5 if off else 4) * size:g}" fill="#{_hex(kind)}" stroke="#1c1e22" '
        f'stroke-width="{2 if off else 1}"/>'
        for at, up, kind, off in marks
    ]


def _hex(kind: int) -> str:
    return "".join(f"{channel:02x}" for channel in OFF_COLOURS[kind][:3])


_LONG_WIDTH, _LONG_HEIGHT = 1120, 260
_ALONG_TITLE = "Ride cost along the way"


def along_chart(result: CheckResult, key: str) -> Html:
    """Return what was measured and what the map says, one stretch after another; empty if nothing was measured.

    Parameters
    ----------
    result : CheckResult
    key : str
        Makes ids on the page differ.
    """
    stretches = result.stretches
    length = float(np.sum(stretches.way_m))
    values = np.concatenate([stretches.measured, stretches.c_r, stretches.c_r_high])
    known = values[np.isfinite(values)]
    if length <= 0.0 or not len(known):
        return Html()
    highest = max(float(np.quantile(known, 0.99)), float(np.nanmax(stretches.measured, initial=0.0))) * 1.08 or 0.1
    right, foot = _LONG_WIDTH - _RIGHT, _LONG_HEIGHT - _BOTTOM
    ends = np.concatenate([[0.0], np.cumsum(stretches.way_m)])
    sides = _LEFT + ends / length * (right - _LEFT)
    middle = (sides[:-1] + sides[1:]) / 2

    def up(c_r: NDArray[np.float64]) -> list[float]:
        places: list[float] = (foot - np.clip(c_r / highest, 0.0, 1.0) * (foot - _TOP)).tolist()
        return places

    parts = []
    for value in _round_steps(highest, 5):
        (y,) = up(np.array([value]))
        parts.append(f'<path d="M{_LEFT} {y:.1f}H{right}" stroke="#e2e4e8"/>')
        parts.append(f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>')
    for value in _round_steps(length, 10):
        x = _LEFT + value / length * (right - _LEFT)
        parts.append(f'<text x="{x:.1f}" y="{foot + 16}" text-anchor="middle">{value:,g}</text>')
    on_map = np.flatnonzero(np.isfinite(stretches.c_r))
    low, high = (
        up(np.where(np.isfinite(end), end, stretches.c_r)[on_map]) for end in (stretches.c_r_low, stretches.c_r_high)
    )
    columns = (sides[on_map].tolist(), sides[on_map + 1].tolist(), low, high, up(stretches.c_r[on_map]))
    boxes = "".join(f"M{a:.1f} {c:.1f}H{b:.1f}V{d:.1f}H{a:.1f}Z" for a, b, c, d, _ in zip(*columns, strict=True))
    lines = "".join(f"M{a:.1f} {e:.1f}H{b:.1f}" for a, b, _, _, e in zip(*columns, strict=True))
    parts.append(f'<path d="{boxes}" fill="#d9dce1"/><path d="{lines}" stroke="#1f2937" stroke-width="2"/>')
    starts = "".join(f"M{x:.1f} {_TOP}V{foot}" for x in sides[1:-1][np.diff(stretches.drive) != 0].tolist())
    parts.append(f'<path d="{starts}" stroke="#6b7280" stroke-width="1.5"/>')
    offset, measured = MapOffset.of(stretches), np.flatnonzero(np.isfinite(stretches.measured))
    half = _NORMAL_80 * np.nan_to_num(stretches.measured_sd[measured])
    felt, x = stretches.measured[measured], middle[measured].tolist()
    errors = "".join(f"M{a:.1f} {b:.1f}V{c:.1f}" for a, b, c in zip(x, up(felt - half), up(felt + half), strict=True))
    parts.append(f'<path d="{errors}" stroke="#9aa0a8"/>')
    parts += _discs(x, up(felt), offset, measured, min(1.0, float(np.median(np.diff(sides))) / 9.0))
    parts.append(
        f'<text x="{(_LEFT + right) / 2}" y="{_LONG_HEIGHT - 8}" text-anchor="middle">'
        "length of the stretches, one after another, m</text>"
    )
    parts.append(
        f'<text transform="translate(16 {(_TOP + foot) / 2}) rotate(-90)" text-anchor="middle">C_r, rad/m</text>'
    )
    title = f"{_ALONG_TITLE}: {count_text(len(stretches.way_m), 'stretch', 'stretches')}"
    note = ". Marks: the drive, with the 80 % error of the measurement."
    if len(on_map):
        note += " Lines on grey: the map, with its 80 % interval."
    return tag(
        "figure",
        tag("figcaption", tag("strong", _ALONG_TITLE), note),
        _svg((_LONG_WIDTH, _LONG_HEIGHT), title, f"along-{key}", parts),
    )


def _round_steps(end: float, most: int) -> list[float]:
    """Return 0 and the multiples of 1, 2 or 5 times a power of ten up to ``end``, at most ``most`` of them."""
    power = 10.0 ** math.floor(math.log10(end / most))
    step = next(power * part for part in (1, 2, 5, 10) if power * part * most >= end)
    return [round(step * number, 12) for number in range(int(end / step + 1e-9) + 1)]


def _svg(size: tuple[int, int], title: str, key: str, parts: Sequence[str]) -> Html:
    return tag(
        "svg",
        tag("title", title, id=key),
        raw("".join(parts)),
        viewBox=f"0 0 {size[0]} {size[1]}",
        role="img",
        aria_labelledby=key,
    )


_Rows = list[tuple[str, ...]]
_AGREEMENT_HEAD = (
    *("ground by the map", "stretches", "way", "map / drive, median", "error, median", "Spearman"),
    *("in the 80 % interval", "same class"),
)
_WORST_HEAD = (
    "drive",
    "from, clock of the IMU",
    "easting, northing, m",
    "drive, rad/m",
    "map, rad/m",
    "map's 80 % interval",
    "map / drive",
)
_WORST = 10
_NO_CLASS_NAME = "off the map"


def _agreement_rows(result: CheckResult) -> _Rows:
    """Return map against drives over all stretches, then by class of the map."""
    if result.agreement is None:
        return []
    by_class = [(f"{code} {CLASS_NAMES[code]}", found) for code, found in sorted(result.by_class.items())]
    return [_agreement(name, found) for name, found in [("all", result.agreement), *by_class] if found.stretches]


def _agreement(name: str, found: MapAgreement) -> tuple[str, ...]:
    return (
        name,
        f"{found.stretches:,}",
        metres(found.way_m),
        number(found.median_ratio, 2),
        percent(found.median_error),
        number(found.spearman, 2),
        percent(found.inside),
        percent(found.same_class),
    )


def _worst_rows(result: CheckResult) -> _Rows:
    """Return the stretches that are farthest off, of those whose difference errors do not explain; at most 10."""
    stretches, offset = result.stretches, MapOffset.of(result.stretches)
    order = np.argsort(-np.nan_to_num(offset.beyond, posinf=np.inf), kind="stable")
    names = [drive.name for drive in result.drives]
    return [
        (
            names[stretches.drive[at]],
            f"{stretches.start_s[at]:.1f} s",
            f"{stretches.easting[at]:.1f}, {stretches.northing[at]:.1f}",
            f"{stretches.measured[at]:.3f} ± {stretches.measured_sd[at]:.3f}",
            f"{stretches.c_r[at]:.3f} ({_class(int(stretches.class_id[at]))})",
            f"{number(float(stretches.c_r_low[at]), 3)} to {number(float(stretches.c_r_high[at]), 3)}",
            f"{offset.ratio[at]:.2f}",
        )
        for at in order[:_WORST].tolist()
        if offset.is_off[at]
    ]


def _drive_rows(drives: Sequence[CheckedDrive]) -> _Rows:
    """Return what was found about each drive and its sensors: a row for each figure, a column for each drive."""
    figures: list[tuple[str, list[str]]] = [
        ("way", [f"{metres(drive.way_m)} in {drive.seconds:,.0f} s" for drive in drives]),
        ("of it counts", [metres(drive.used_m) for drive in drives]),
        ("median speed there", [number(drive.speed_mps, 2, " m/s") for drive in drives]),
        ("rate of the IMU", [number(drive.rate_hz, 0, " Hz") for drive in drives]),
        ("pitch rates kept up to", [number(drive.band_hz, 1, " Hz") for drive in drives]),
        ("positions, standard deviation", [number(drive.position_error_m, 2, " m") for drive in drives]),
        ("clock of the positions", [_clock(drive) for drive in drives]),
        ("IMU in the vehicle: roll, pitch, yaw", [_mount(drive.mount_deg) for drive in drives]),
        ("floor at standstill", [number(drive.floor_radps, 4, " rad/s") for drive in drives]),
    ]
    return [(label, *texts) for label, texts in figures]


def _left_out_rows(result: CheckResult) -> _Rows:
    """Return why parts of the ways do not count, with their lengths over all drives."""
    return [(reason, metres(length)) for reason, length in sorted_reasons(result)]


def _class(code: int) -> str:
    return _NO_CLASS_NAME if code == NO_CLASS else CLASS_NAMES[code]


def _clock(drive: CheckedDrive) -> str:
    if not math.isfinite(drive.clock_offset_s):
        return "cannot be told"
    text = f"{drive.clock_offset_s:+.3f} s"
    if math.isfinite(drive.clock_offset_sd_s):
        text += f" ± {drive.clock_offset_sd_s:.3f} s"
    return f"{text}, {drive.clock_drift_ppm:+.0f} ppm" if math.isfinite(drive.clock_drift_ppm) else text


def _mount(angles: Iterable[float]) -> str:
    return ", ".join(f"{angle:+.1f}°" if math.isfinite(angle) else DASH for angle in angles)


_AGAIN = "The layers were written again after this check: check them again for figures of this map."
_OFF = "Stretches that are off by more than the map's interval and the errors of measurement explain"


def drive_figures(check: DrawnCheck, key: str) -> Html:
    """Return what drives say of one map, or alone: charts, by class, stretch by stretch, and the drives themselves.

    Parameters
    ----------
    check : DrawnCheck
    key : str
        Makes ids on the page differ.
    """
    result = check.result
    rows, worst = _agreement_rows(result), _worst_rows(result)
    return join(
        Html() if check.is_of_this_run else tag("p", tag("strong", _AGAIN)),
        _warnings(result),
        drive_chart(result, f"drives-{key}"),
        along_chart(result, key),
        table("Map against drives", _AGREEMENT_HEAD, rows, wide=True) if rows else Html(),
        table(_OFF, _WORST_HEAD, worst, wide=True) if worst else Html(),
        _details(result),
    )


def _warnings(result: CheckResult) -> Html:
    found = [*skipped_words(result), *warnings_of(result)]
    return join(tag("h3", "Warnings"), lines_of(*found)) if found else Html()


def _details(result: CheckResult) -> Html:
    names = [drive.name for drive in result.drives]
    rows, left = _drive_rows(result.drives), _left_out_rows(result)
    return tag(
        "details",
        tag("summary", "The drives and their sensors"),
        table("The drives", ("figure", *names), rows, texts=1 + len(names), wide=len(names) > 1),
        lines_of(*drive_notes(result)),
        table("Parts of the ways that do not count", ("why", "way"), left) if left else Html(),
    )


_READ = """
Ride cost C_r is pitch motion per metre driven, rad/m. Each drive is cut into stretches; on each, the C_r that the IMU
measured, less what it reads at standstill, stands beside that of the map over the same ground."""
_READ_FIGURES = """
map / drive: the ratio of both. Under 1, the ground is rougher for this vehicle than the map says. Its median over many
stretches says whether the level of the map fits this vehicle. A level that is off alike on all classes is one number to
correct; one that differs by class says that smooth and rough ground are off in different ways.

error: the median of the absolute difference of that ratio from 1.

Spearman: the correlation of ranks. At 1 the map puts all stretches in the order in which the vehicle felt them.
Planning routes needs this more than the level. Where all ground is alike it says little.

in the 80 % interval: the share of stretches whose measurement lies in the map's interval, widened by the error of the
measurement. 80 % is right; far less means that the map is surer than it may be.

A stretch is off only if neither the map's interval nor the errors of measurement and position explain the difference.
If all is as it should be, that happens on one stretch in five."""


def reading_notes(result: CheckResult) -> Html:
    """Return how to read the figures of a check."""
    figures = _READ_FIGURES.strip().split("\n\n") if result.agreement is not None else []
    return join(tag("p", _READ.strip()), lines_of(*figures) if figures else Html())
