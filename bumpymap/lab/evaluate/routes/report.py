"""Write the report of an evaluation of routes: Markdown, JSON and plots."""

from dataclasses import asdict
from pathlib import Path

from bumpymap.lab.evaluate.document import number, percent, report_text, section, table, write_document
from bumpymap.lab.evaluate.routes.compare import WayResult
from bumpymap.lab.evaluate.routes.pictures import draw_routes
from bumpymap.lab.evaluate.routes.run import RouteFindings, RouteTrialData
from bumpymap.lab.evaluate.routes.trial import WAYS

__all__ = ["route_markdown", "write_route_report"]

_C_R = (
    "C_r of a whole way: predicted is the mean of c_r along the planned line, weighted by length; driven is the mean "
    "over the drives that arrived. The interval is the mean of the ends of the tiles' 80 % intervals. *Raw* is the "
    "prediction without noise correction: the drives run over the heights as they were measured, noise included, while "
    "the map predicts the ground without it, so the raw prediction is the one for the driven surface. *Raw / map* is "
    "what the correction takes off."
)
_ORDER = (
    "Where both ways of a pair were driven to the end, the map is right if the one of lower predicted C_r was the "
    "smoother one. Where only one was, it must be the one that is cheaper on the map."
)
_ARRIVALS = (
    "P(arrives) = exp(-sum of hazards) against the share of the drives that arrived. The drives along one way are much "
    "alike, so for the 95 % interval (Wilson) each way counts as one trial. *Ways inside* counts the ways whose own "
    "P(arrives) lies in the interval of their own drives. *Failed at an obstacle*: drives that ended where the tile of "
    "the way holds an obstacle. Such a tile is passable beside it, but a way that is planned on tiles does not know "
    "where, and p_fail is of the ground alone."
)
_GROUND = (
    "Tiles with at least 1 m of driven path along the best ways, by the class of their predicted C_r; only drives that "
    "arrived. A tile is crossed on a few metres and in one direction, so single tiles differ more than whole ways."
)


def write_route_report(findings: RouteFindings, data: RouteTrialData, out: Path) -> list[Path]:
    """Write the plots, ``report.json`` and ``report.md``, in this order."""
    pictures = draw_routes(findings, data, out)
    files = write_document(out, route_markdown(findings, pictures), "bumpymap-route-evaluation", asdict(findings))
    return [*files, *(out / name for name in pictures)]


def route_markdown(findings: RouteFindings, pictures: list[str]) -> str:
    """Return the text of the report; ``pictures`` are names of files."""
    drawn = [line for name in pictures for line in (f"![{name.partition('.')[0].replace('_', ' ')}]({name})", "")]
    sections = [
        section("C_r of whole ways", _C_R, _agreement_lines(findings)),
        section("Best way against straight line", _ORDER, _order_lines(findings)),
        section("Arrivals", _ARRIVALS, _arrival_lines(findings)),
        section("By class of ground", _GROUND, _ground_lines(findings)),
        section("Ways", "", [*drawn, *_way_lines(findings)]),
    ]
    return report_text("Can routes be trusted?", [_opening(findings), ""], sections)


def _opening(findings: RouteFindings) -> str:
    facts, settings = findings.facts, findings.settings
    return (
        f"Layers of {', '.join(facts['inputs'])} for {facts['vehicle']} (calibration `{facts['calibration']}`): "
        f"{facts['tiles']:,} rated tiles, {facts['passable']:,} passable. {facts['pairs']} pairs of places "
        f"{settings['least_m']:g} to {settings['most_m']:g} m apart, seed {settings['seed']}; along the best way and "
        f"along the straight line of each, {settings['repeats']} drives up to {settings['offset_m']:g} m beside it, "
        "over the measured heights. Straight lines may cross barred ground."
    )


def _agreement_lines(findings: RouteFindings) -> list[str]:
    header = ("way", "ways", "median error", "predicted / driven", "in the interval", "raw: median error")
    more = ("raw / driven", "raw / map", "spread of the drives", "pitch while turning")
    rows = [
        [
            name,
            str(own.ways),
            percent(own.median_error),
            number(own.median_ratio),
            percent(own.held),
            percent(own.raw_error),
            number(own.raw_ratio),
            number(own.noise_ratio),
            percent(own.spread),
            percent(own.turning_share),
        ]
        for name, own in findings.agreement.items()
    ]
    return table((*header, *more), rows)


def _order_lines(findings: RouteFindings) -> list[str]:
    found = findings.order
    share = percent(found.right / found.compared) if found.compared else "-"
    text = (
        f"Right on {found.right} of {found.compared} pairs ({share}): {found.by_c_r_right} of {found.by_c_r} where "
        f"both ways were driven to the end, {found.by_arrival_right} of {found.by_arrival} where one was. On "
        f"{found.pairs - found.compared} of {found.pairs} pairs no drive arrived. The straight line is dearer than the "
        f"best way on the map on {found.dearer_straight} pairs."
    )
    return [text, ""]


def _arrival_lines(findings: RouteFindings) -> list[str]:
    rows = [
        [
            name,
            str(own.ways),
            str(own.drives),
            percent(own.expected),
            percent(own.arrived),
            f"{percent(own.low)} to {percent(own.high)}",
            "yes" if own.held else "no",
            f"{own.ways_held} of {own.ways}",
            f"{own.obstacle_stops} of {own.drives - round(own.arrived * own.drives)}",
        ]
        for name, own in findings.arrivals.items()
    ]
    header = ("way", "ways", "drives", "P(arrives)", "arrived", "95 % interval", "inside", "ways inside")
    return table((*header, "failed at an obstacle"), rows)


def _ground_lines(findings: RouteFindings) -> list[str]:
    rows = [
        [
            str(row.class_id),
            str(row.tiles),
            number(row.path_m, 4),
            number(row.predicted),
            number(row.driven),
            number(row.predicted / row.driven) if row.tiles else "-",
            number(row.raw / row.driven) if row.tiles else "-",
            percent(row.median_error),
        ]
        for row in findings.ground
    ]
    header = (
        "class",
        "tiles",
        "driven [m]",
        "predicted C_r [rad/m]",
        "driven C_r",
        "predicted / driven",
        "raw / driven",
    )
    return table((*header, "median error of a tile"), rows)


def _way_lines(findings: RouteFindings) -> list[str]:
    pairs = zip(*(findings.of(name) for name in WAYS), strict=True)
    header = ("pair", "way", "length [m]", "barred [m]", "predicted C_r", "interval", "raw", "driven C_r")
    more = ("P(arrives)", "arrived", "how the others ended")
    return table((*header, *more), [_way_row(way) for pair in pairs for way in pair])


def _way_row(way: WayResult) -> list[str]:
    said = way.predicted
    ends = [f"{made.outcome} at {made.reached_m:.0f} m" for made in way.drives if made.outcome != "completed"]
    return [
        str(way.pair + 1),
        way.name,
        f"{said.length_m:.0f}",
        f"{said.barred_m:.0f}",
        number(said.c_r),
        f"{number(said.c_r_low)} to {number(said.c_r_high)}",
        number(said.c_r_raw),
        number(way.c_r),
        percent(said.p_arrives),
        f"{way.arrived} of {len(way.drives)}",
        ", ".join(ends) or "-",
    ]
