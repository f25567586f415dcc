"""Drives that a map was checked against: their section on its page, the chart of map against drive as inline SVG."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, CheckResult, DrivenStretches, count_text
from bumpymap.layers.check.offset import LogAxis, MapOffset
from bumpymap.layers.check.record import read_check
from bumpymap.layers.check.words import (
    AGREEMENT_HEAD,
    WORST_HEAD,
    agreement_rows,
    check_headline,
    drive_notes,
    drive_rows,
    left_out_rows,
    percent,
    warnings_of,
    worst_rows,
)
from bumpymap.layers.colours import OFF_COLOURS
from bumpymap.layers.manifest import MANIFEST_NAME, describe_file
from bumpymap.layers.report.markup import Html, join, lines_of, raw, table, tag

__all__ = ["DrawnCheck", "drive_chart", "drive_figures", "read_drawn_check"]

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
    picture = tag(
        "svg",
        tag(
            "title", f"{_TITLE}: a mark for each of {count_text(len(shown), 'stretch', 'stretches')}", id=f"chart-{key}"
        ),
        raw("".join(parts)),
        viewBox=f"0 0 {_WIDTH} {_HEIGHT}",
        role="img",
        aria_labelledby=f"chart-{key}",
    )
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
    marks = zip(x, y, offset.kind[order].tolist(), offset.is_off[order].tolist(), strict=True)
    return [
        f'<circle cx="{at:.1f}" cy="{up:.1f}" r="{5.5 if off else 4}" fill="#{_hex(kind)}" stroke="#1c1e22" '
        f'stroke-width="{2 if off else 1}"/>'
        for at, up, kind, off in marks
    ]


def _hex(kind: int) -> str:
    return "".join(f"{channel:02x}" for channel in OFF_COLOURS[kind][:3])


_AGAIN = "The layers were written again after this check: check them again for figures of this map."
_OFF = "Stretches that are off by more than the map's interval and the errors of measurement explain"


def drive_figures(check: DrawnCheck, key: str) -> Html:
    """Return what drives say of one map: in words, by class, stretch by stretch, and the drives themselves.

    Parameters
    ----------
    check : DrawnCheck
    key : str
        Makes ids on the page differ.
    """
    result = check.result
    worst = worst_rows(result)
    return join(
        tag("p", check_headline(result)),
        Html() if check.is_of_this_run else tag("p", tag("strong", _AGAIN)),
        _warnings(result),
        drive_chart(result, f"drives-{key}"),
        table("Map against drives", AGREEMENT_HEAD, agreement_rows(result), wide=True),
        table(_OFF, WORST_HEAD, worst, wide=True) if worst else Html(),
        _details(result),
    )


def _warnings(result: CheckResult) -> Html:
    found = warnings_of(result)
    return join(tag("h3", "Warnings"), lines_of(*found)) if found else Html()


def _details(result: CheckResult) -> Html:
    names = [drive.name for drive in result.drives]
    rows, left = drive_rows(result.drives), left_out_rows(result)
    return tag(
        "details",
        tag("summary", "The drives and their sensors"),
        table("The drives", ("figure", *names), rows, texts=1 + len(names), wide=len(names) > 1),
        lines_of(*drive_notes(result)),
        table("Parts of the ways that do not count", ("why", "way"), left) if left else Html(),
    )
