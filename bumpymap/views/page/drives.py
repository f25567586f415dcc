"""Drives that a map was checked against, as their page shows them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bumpymap.core import (
    CLASS_NAMES,
    NO_CLASS,
    CheckedDrive,
    CheckResult,
    MapAgreement,
)
from bumpymap.layers import MapOffset
from bumpymap.views.page.charts import Chart, along_chart, drive_chart
from bumpymap.views.words import (
    DASH,
    check_headline,
    drive_notes,
    metres,
    number,
    percent,
    skipped_words,
    sorted_reasons,
    warnings_of,
)

__all__ = ["DrawnCheck"]


@dataclass(frozen=True, slots=True)
class DrawnCheck:
    """Findings of drives over the map of a page."""

    result: CheckResult

    @property
    def headline(self) -> str:
        """The result in two or three sentences."""
        return check_headline(self.result)

    def charts(self) -> list[Chart]:
        """Return the charts of what the drives measured."""
        return [chart for chart in (drive_chart(self.result), along_chart(self.result)) if chart is not None]

    def tables(self) -> dict[str, list[Any]]:
        """Return the rows of the tables about drives, by what they hold, with their warnings and notes as texts."""
        result = self.result
        entries = [("all", result.agreement)] if result.agreement is not None else []
        entries += [(f"{code} {CLASS_NAMES[code]}", found) for code, found in sorted(result.by_class.items())]
        return {
            "warnings": [*skipped_words(result), *warnings_of(result)],
            "agreement": [_agreement(name, found) for name, found in entries if found.stretches],
            "worst": _worst(result),
            "drives": _sensors(result.drives),
            "notes": drive_notes(result),
            "left_out": [(reason, metres(length)) for reason, length in sorted_reasons(result)],
        }

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


_WORST = 10


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


def _worst(result: CheckResult) -> list[tuple[str, ...]]:
    """Return the stretches that are farthest off, of those whose difference errors do not explain; at most 10."""
    stretches, offset = result.stretches, MapOffset.of(result.stretches)
    order = np.argsort(-np.nan_to_num(offset.beyond, posinf=np.inf), kind="stable")
    classes = dict(enumerate(CLASS_NAMES)) | {NO_CLASS: "off the map"}
    return [
        (
            result.drives[stretches.drive[at]].name,
            f"{stretches.start_s[at]:.1f} s",
            f"{stretches.easting[at]:.1f}, {stretches.northing[at]:.1f}",
            f"{stretches.measured[at]:.3f} ± {stretches.measured_sd[at]:.3f}",
            f"{stretches.c_r[at]:.3f} ({classes[int(stretches.class_id[at])]})",
            f"{number(float(stretches.c_r_low[at]), 3)} to {number(float(stretches.c_r_high[at]), 3)}",
            f"{offset.ratio[at]:.2f}",
        )
        for at in order[:_WORST].tolist()
        if offset.is_off[at]
    ]


def _sensors(drives: Sequence[CheckedDrive]) -> list[tuple[str, ...]]:
    """Return what was found about each drive and its sensors: a row for each figure, a column for each drive."""
    columns = [
        (
            f"{metres(drive.way_m)} in {drive.seconds:,.0f} s",
            metres(drive.used_m),
            number(drive.speed_mps, 2, " m/s"),
            number(drive.rate_hz, 0, " Hz"),
            number(drive.band_hz, 1, " Hz"),
            number(drive.position_error_m, 2, " m"),
            _clock(drive),
            ", ".join(f"{angle:+.1f}°" if math.isfinite(angle) else DASH for angle in drive.mount_deg),
            number(drive.floor_radps, 4, " rad/s"),
        )
        for drive in drives
    ]
    names = (
        *("way", "of it counts", "median speed there", "rate of the IMU", "pitch rates kept up to"),
        *("positions, standard deviation", "clock of the positions", "IMU in the vehicle: roll, pitch, yaw"),
        "floor at standstill",
    )
    return list(zip(names, *columns, strict=True))


def _clock(drive: CheckedDrive) -> str:
    if not math.isfinite(drive.clock_offset_s):
        return "not known"
    text = f"{drive.clock_offset_s:+.3f} s"
    if math.isfinite(drive.clock_offset_sd_s):
        text += f" ± {drive.clock_offset_sd_s:.3f} s"
    return f"{text}, {drive.clock_drift_ppm:+.0f} ppm" if math.isfinite(drive.clock_drift_ppm) else text
