"""Write the report of an evaluation: Markdown, JSON and plots."""

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
    """Write the plots, ``report.json`` and ``report.md``, in this order."""
    pictures = draw(findings, out)
    files = write_document(out, markdown(findings, pictures), "bumpymap-evaluation", asdict(findings))
    return [*files, *(out / name for name in pictures.values())]


def markdown(findings: Findings, pictures: dict[str, str]) -> str:
    """Return the text of the report; ``pictures`` maps part of the report -> file."""
    found = findings
    classes = [*class_lines(found.classes), ""] if found.classes else []
    density = [*density_lines(found.densities), *_picture("Share of tiles against density", pictures.get("density"))]
    noise = [*noise_lines(found.noise), *_picture("C_r of dead-flat ground", pictures.get("noise"))]
    sections = [
        section("Statistics of the classes", "The paper's Table I, over all classified tiles.", classes),
        *(_driven(vehicle, own, pictures) for vehicle, own in found.comparisons.items()),
        section("By kind of ground", "", kind_lines(found.kinds) if found.kinds else []),
        section("Order of the vehicles", _ORDER, order_lines(found.orders) if found.orders else []),
        section("With fewer points", _DENSITY, density if found.densities else []),
        section("With scan noise", _NOISE, noise if found.noise else []),
        section("Turned, mirrored, tilted, lifted", _MOVES, move_lines(found.moves) if found.moves else []),
        section("What a patch costs", _TIMING, timing_lines(found.timing) if found.timing else []),
    ]
    return report_text("Can the map be trusted?", [*_opening(found), *_conclusion(found)], sections)


def _picture(title: str, file: str | None) -> list[str]:
    return [f"![{title}]({file})", ""] if file else []


_ORDER = (
    "On each patch the vehicles are sorted by predicted and by driven C_r. Only patches on which the C_r of every "
    "vehicle can be compared are counted. The drives separate the vehicles if neighbours differ by more than two "
    "standard errors."
)
_DENSITY = (
    "The survey is thinned at random, rated again and compared with the rating of all points. A density is the mean "
    "over the classified tiles; densities that the survey does not exceed are left out. The share with the same class "
    "is over tiles that can still be classified; *mean over classes* averages that share over the classes, so that "
    "all classes have the same weight."
)
_NOISE = (
    "Ground of the library, surveyed with white noise. Errors are relative to the ride model's C_r of the same ground "
    "without noise; intervals are compared with the driven C_r if there are drives. *Not denoised* is the same model "
    "without its noise correction. Thirds are by true C_r."
)
_MOVES = (
    "The points of each tile are moved inside it and rated again. Tiles steeper than the vehicle's slope limit, before "
    "or after, are left out, because their class follows from the slope alone."
)
_TIMING = (
    "One thread, one batch of patches, points already in memory; median of seven runs in processor time. *measure* "
    "computes heightmap, variance, RANSAC residual and slope; *texture* runs the network; *ride* and *table* rate the "
    "measured tiles. The paper's figures are from its own machine (i7, RTX 3070) and are not measured here."
)


def _opening(findings: Findings) -> list[str]:
    facts = findings.facts
    if findings.title == "library":
        first = f"{facts['terrains']} unseen terrains of the library, seed {facts['seed']}."
    else:
        points = "points of class 2 (ground) only" if facts["ground_only"] else "all points"
        why = ", ".join(f"{name}: {count}" for name, count in facts["unknown_tiles"].items())
        unknown = f"{sum(facts['unknown_tiles'].values())} unknown" + (f" ({why})" if why else "")
        first = (
            f"Survey {', '.join(facts['files'])}: {facts['points']:,} points, measured from {points}; "
            f"{facts['judged_tiles']} tiles classified, {unknown}, "
            f"{facts['density']:.0f} points per m2 on the classified ones."
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


def _conclusion(findings: Findings) -> list[str]:
    """Summarise the comparison with the drives."""
    lines = []
    for vehicle, found in findings.comparisons.items():
        for name in MAPPED:
            if name in found.agreement and found.patches > found.left_out:
                own = found.agreement[name]
                held = f"; {percent(own.coverage.held)} of its 80 % intervals contain it" if own.coverage else ""
                lines.append(
                    f"- **{vehicle}, `{name}`**: C_r is off by {percent(own.median_error)} in the median{held}; "
                    f"{percent(own.steps.same)} of the classes are the driven ones, {percent(own.steps.further)} are "
                    f"off by two or more."
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
        "Failed drives by predicted `p_fail`, in bins of width 0.2; all patches have the same weight:",
        "",
        *reliability_lines(found),
        *_picture("Predicted against driven failures", pictures[f"reliability {vehicle}"]),
    ]
    return section(f"Predicted and driven: {vehicle}", _method(found), lines)


def _method(found: Comparison) -> str:
    noise = (
        " `ride_raw` is `ride` without noise correction: the drives run on the measured relief and contain its noise "
        "too, while `ride` predicts the ground without noise."
    )
    return (
        f"{found.patches} patches, {found.drives} drives, {found.failed} of them failed. On {found.left_out} patches "
        "more than a quarter of the drives failed; their C_r, of the completed drives only, is not compared. The "
        f"standard error of the driven C_r is {percent(found.label_error)} in the median, and above 5 % on "
        f"{found.label_error_over} patches. "
        "Failures are compared on all patches, classes on those within the vehicle's slope limit: "
        f"{found.beyond_limit} are beyond it and have class 3 by definition. "
        f"As some drives over a patch fail and others do not, no p_fail can reach an AUC above {found.auc_most:.3f}, "
        f"or above {found.auc_most_below_limit:.3f} within the slope limit. Plain "
        "predictors get C_r from their best monotone fit to the drives over the other patches, which a map does not "
        "have; *fitted to these* is the error if the fit includes the patch itself."
        + (noise if "ride_raw" in found.agreement else "")
    )


def _against_plain(found: Comparison) -> list[str]:
    plain = {name: 1 - found.agreement[name].spearman for name in _PLAIN if name in found.agreement}
    known = {name: lack for name, lack in plain.items() if math.isfinite(lack)}
    if not known or min(known.values()) <= 0:
        return []
    best = min(known, key=lambda name: known[name])
    ratios = [
        f"{(1 - found.agreement[name].spearman) / known[best]:.2f} times for `{name}`"
        for name in ("ride", "ride_raw", "table")
        if name in found.agreement and math.isfinite(found.agreement[name].spearman)
    ]
    return [f"1 - Spearman relative to that of the best plain predictor, `{best}`: {', '.join(ratios)}.", ""]
