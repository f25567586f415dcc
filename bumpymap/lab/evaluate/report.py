"""The report: Markdown for people, JSON for machines, pictures beside them."""

import math
from dataclasses import asdict
from pathlib import Path

from bumpymap.lab.evaluate.compare import Comparison
from bumpymap.lab.evaluate.document import number, percent, report_text, section, table, write_document
from bumpymap.lab.evaluate.findings import Findings
from bumpymap.lab.evaluate.pictures import draw
from bumpymap.lab.evaluate.subject import MAPPED
from bumpymap.lab.evaluate.tables import (
    class_lines,
    confusion_lines,
    density_lines,
    driven_lines,
    kind_lines,
    move_lines,
    noise_lines,
    order_lines,
    reliability_lines,
    timing_lines,
)

__all__ = ["markdown", "write_report"]

_PLAIN = ("z_variance", "ransac_residual", "slope_free_sd")


def write_report(findings: Findings, out: Path) -> list[Path]:
    """Write ``report.md``, ``report.json`` and the pictures; the report comes last."""
    pictures = draw(findings, out)
    files = write_document(out, markdown(findings, pictures), "bumpymap-evaluation", asdict(findings))
    return [*files, *(out / name for name in pictures.values())]


def markdown(findings: Findings, pictures: dict[str, str]) -> str:
    """Return the text of the report; ``pictures``: part of it -> file."""
    found = findings
    classes = [*class_lines(found.classes), ""] if found.classes else []
    density = [*density_lines(found.densities), *_picture("Share of tiles against density", pictures.get("density"))]
    noise = [*noise_lines(found.noise), *_picture("C_r of dead-flat ground", pictures.get("noise"))]
    sections = [
        section("What the classes hold", "The paper's Table I, over every judged tile.", classes),
        *(_driven(vehicle, own, pictures) for vehicle, own in found.comparisons.items()),
        section("By kind of ground", "", kind_lines(found.kinds) if found.kinds else []),
        section("Order of the vehicles", _ORDER, order_lines(found.orders) if found.orders else []),
        section("With fewer points", _DENSITY, density if found.densities else []),
        section("With scan noise", _NOISE, noise if found.noise else []),
        section("Turned, mirrored, tilted, lifted", _MOVES, move_lines(found.moves) if found.moves else []),
        section("What a patch costs", _TIMING, timing_lines(found.timing) if found.timing else []),
    ]
    return report_text("Can the map be trusted?", [*_opening(found), *_answer(found)], sections)


def _picture(title: str, file: str | None) -> list[str]:
    return [f"![{title}]({file})", ""] if file else []


_ORDER = (
    "On each patch the vehicles are sorted by C_r, as predicted and as driven. Patches count where every vehicle's C_r "
    "does. The drives tell vehicles apart where neighbours differ by more than two standard errors."
)
_DENSITY = (
    "The survey with a random part of its points, rated again and held against the rating of all points. A density is "
    "the mean over the judged tiles; those that the survey does not exceed are left out. Shares of kept classes are "
    "over tiles that can still be judged; *classes alike* is the mean of that share over the classes, so that the one "
    "that holds most tiles does not speak for all."
)
_NOISE = (
    "Ground of the library, surveyed with white noise. Errors are against the ride model's own C_r of the same ground "
    "without noise; intervals are held against the driven C_r where there are drives. *Noise left in* is the same "
    "model without its noise correction. Thirds are by true C_r."
)
_MOVES = (
    "The points of each tile are moved inside it and rated again. Tiles that pass the vehicle's slope limit, before or "
    "after, are left out: that limit is a rule about the slope itself."
)
_TIMING = (
    "One thread, one batch of patches, points already in memory; median of seven runs in processor time. *measure* "
    "gives heightmap, variance, RANSAC residual and slope; *texture* runs the network; *ride* and *table* rate what is "
    "measured. The paper's figures are from its own machine (i7, RTX 3070) and are not measured here."
)


def _opening(findings: Findings) -> list[str]:
    facts = findings.facts
    if findings.title == "library":
        first = f"{facts['terrains']} unseen terrains of the library, seed {facts['seed']}."
    else:
        points = "points of class 2 (ground) alone" if facts["ground_only"] else "all points"
        why = ", ".join(f"{name}: {count}" for name, count in facts["unknown_tiles"].items())
        unknown = f"{sum(facts['unknown_tiles'].values())} unknown" + (f" ({why})" if why else "")
        first = (
            f"Survey {', '.join(facts['files'])}: {facts['points']:,} points, measured from {points}; "
            f"{facts['judged_tiles']} tiles judged, {unknown}, "
            f"{facts['density']:.0f} points per m2 on the judged ones."
        )
    rows = [
        [
            one["vehicle"],
            f"`{one['calibration']}`",
            " / ".join(number(limit) for limit in one["class_limits"]),
            ", ".join(f"`{name}`" for name in one["ratings"]),
        ]
        for one in findings.vehicles
    ]
    return [first, "", *table(("vehicle", "calibration", "class limits [rad/m]", "ratings"), rows)]


def _answer(findings: Findings) -> list[str]:
    """Say in short what the drives say."""
    lines = []
    for vehicle, found in findings.comparisons.items():
        for name in MAPPED:
            if name in found.agreement and found.patches > found.left_out:
                own = found.agreement[name]
                held = f"; {percent(own.coverage.held)} of its 80 % intervals hold" if own.coverage else ""
                lines.append(
                    f"- **{vehicle}, `{name}`**: C_r is off by {percent(own.median_error)} in the median; "
                    f"{percent(own.steps.same)} of the classes are the driven ones, {percent(own.steps.further)} are "
                    f"off by two or more{held}."
                )
    return [*lines, ""] if lines else []


def _driven(vehicle: str, found: Comparison, pictures: dict[str, str]) -> list[str]:
    confusions = [
        line
        for name in MAPPED
        if name in found.agreement
        for line in confusion_lines(name, found.agreement[name].confusion, "driven", "predicted")
    ]
    lines = [
        *driven_lines(found),
        *_against_plain(found),
        *_picture("Predicted against driven C_r", pictures[f"scatter {vehicle}"]),
        *confusions,
        "Failed drives by predicted `p_fail`, in bins a fifth wide; every patch counts alike:",
        "",
        *reliability_lines(found),
        *_picture("Predicted against driven failures", pictures[f"reliability {vehicle}"]),
    ]
    return section(f"Predicted and driven: {vehicle}", _method(found), lines)


def _method(found: Comparison) -> str:
    noise = (
        " `ride_raw` is `ride` with the scan's noise left in: the drives feel that noise too, since they run on the "
        "measured relief, while `ride` predicts the ground behind it."
    )
    return (
        f"{found.patches} patches, {found.drives} drives, {found.failed} of them failed. On {found.left_out} patches "
        "more than a quarter of the drives failed; their C_r, that of the survivors, is not compared. The drives' own "
        f"standard error is {percent(found.label_error)} in the median, above 5 % on {found.label_error_over} of them. "
        f"Failures count on all patches, classes on those within the vehicle's slope limit: {found.beyond_limit} are "
        "beyond it, where class 3 is a rule and no prediction. "
        f"Some drives over a patch fail and others do not: no p_fail can reach an AUC above {found.auc_most:.3f} "
        f"here, nor above {found.auc_most_below_limit:.3f} within the slope limit. Plain "
        "predictors get C_r by their best monotone fit to the drives over the other patches, which no map has; *fitted "
        "to these* is the error where the fit has seen the patch itself."
        + (noise if "ride_raw" in found.agreement else "")
    )


def _against_plain(found: Comparison) -> list[str]:
    plain = {name: 1 - found.agreement[name].spearman for name in _PLAIN if name in found.agreement}
    known = {name: lack for name, lack in plain.items() if math.isfinite(lack)}
    if not known or min(known.values()) <= 0:
        return []
    best = min(known, key=lambda name: known[name])
    said = [
        f"{(1 - found.agreement[name].spearman) / known[best]:.2f} times for `{name}`"
        for name in ("ride", "ride_raw", "table")
        if name in found.agreement and math.isfinite(found.agreement[name].spearman)
    ]
    return [f"1 - Spearman over that of the best plain predictor, `{best}`: {', '.join(said)}.", ""]
