"""Drives that a map was checked against, as their page shows them."""

from typing import Any

import numpy as np

from bumpymap.core import (
    CLASS_NAMES,
    NO_CLASS,
    CheckResult,
    MapAgreement,
)
from bumpymap.layers import MapOffset
from bumpymap.views.page.charts import Chart, along_chart, drive_chart
from bumpymap.views.words import (
    agreements_of,
    metres,
    number,
    percent,
    skipped_words,
    warnings_of,
)


def check_charts(result: CheckResult) -> list[Chart]:
    """Return the charts of what the drives measured."""
    return [chart for chart in (drive_chart(result), along_chart(result)) if chart is not None]


def check_tables(result: CheckResult) -> dict[str, list[Any]]:
    """Return the rows of the tables about drives, by what they hold, with the warnings as texts."""
    return {
        "warnings": [*skipped_words(result), *warnings_of(result)],
        "agreement": [_agreement(name, found) for name, found in agreements_of(result) if found.stretches],
        "worst": _worst(result),
    }


def drawn_stretches(result: CheckResult) -> list[dict[str, Any]]:
    """Return each stretch with a position as the script of the page needs it."""
    stretches, offset, drawn = result.stretches, MapOffset.of(result.stretches), []
    for at in np.flatnonzero(np.isfinite(stretches.easting) & np.isfinite(stretches.northing)).tolist():
        text = f"{result.drives[stretches.drive[at]].name} measured {stretches.measured[at]:.3f} rad/m"
        ratio = float(offset.ratio[at])
        if np.isfinite(ratio):
            level = f"{percent(abs(ratio - 1.0))} {'high' if ratio > 1.0 else 'low'}"
            text += f", the map says {stretches.c_r[at]:.3f} along the stretch ({level})"
        place = {"east": round(float(stretches.easting[at]), 2), "north": round(float(stretches.northing[at]), 2)}
        drawn.append(place | {"kind": int(offset.kind[at]), "off": bool(offset.is_off[at]), "text": text})
    return drawn


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
