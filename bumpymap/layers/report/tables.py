"""The tables of a page: one column, or group of columns, for each map."""

from collections.abc import Callable, Sequence

from bumpymap.core import BARRED_TEXT, CLASS_NAMES, REASON_TEXT, Barred, Reason
from bumpymap.layers.report.markup import Html, join, table, tag
from bumpymap.layers.report.numbers import DASH, area, number, share, whole
from bumpymap.layers.report.site import Site

__all__ = ["bar_table", "class_limits", "class_table", "reason_table"]


def class_limits(site: Site) -> tuple[float, ...]:
    """Return the limits between the classes, rad/m; none if the record does not hold them."""
    calibration = site.record.get("calibration")
    limits = calibration.get("class_limits") if isinstance(calibration, dict) else None
    return tuple(float(limit) for limit in limits or ())


def class_table(sites: Sequence[Site]) -> Html:
    """Return the table of classes: limits, tiles, area, share, median ride cost and slope."""
    if len(sites) > 1:
        return _compared("Classes", ("class", *CLASS_NAMES, "not known"), _class_counts, sites)
    (site,) = sites
    summary, limits = site.summary, class_limits(site)
    rows = [
        (
            f"{code} {name}",
            *_counted(site, summary.by_class[code]),
            _range(limits, code),
            number(summary.median_c_r[code], 3),
            number(summary.median_slope[code], 1),
        )
        for code, name in enumerate(CLASS_NAMES)
    ]
    slope = number(summary.median_slope[len(CLASS_NAMES)], 1)
    rows.append(("not known", *_counted(site, summary.unknown), DASH, DASH, slope))
    rows.append(("all", *_counted(site, summary.tiles), "", "", ""))
    head = ("class", "share", "area", "tiles", "C_r, rad/m", "median C_r, rad/m", "median slope, °")
    return table("Classes", head, rows, wide=True)


def bar_table(sites: Sequence[Site]) -> Html:
    """Return the table of what the vehicle can cross, and what keeps it from the rest."""
    if len(sites) > 1:
        names = [BARRED_TEXT[code] for code in Barred if any(site.summary.by_bar[code] for site in sites)]
        codes = [code for code in Barred if any(site.summary.by_bar[code] for site in sites)]
        return _compared(
            "What can be crossed",
            ("ground", *names),
            lambda site: [site.summary.by_bar[code] for code in codes],
            sites,
        )
    (site,) = sites
    rows = [
        (_explained(BARRED_TEXT[code], _WHY[code]), *_counted(site, site.summary.by_bar[code]))
        for code in Barred
        if site.summary.by_bar[code] or code == Barred.NO
    ]
    return table("What can be crossed", ("ground", "share", "area", "tiles"), rows)


def reason_table(sites: Sequence[Site]) -> Html:
    """Return the table of why tiles are not known."""
    if len(sites) > 1:
        codes = [code for code in Reason if any(site.summary.by_reason[code] for site in sites)]
        names = [REASON_TEXT[code] for code in codes]
        return _compared(
            "Why ground is not known",
            ("reason", *names),
            lambda site: [site.summary.by_reason[code] for code in codes],
            sites,
        )
    (site,) = sites
    rows = [
        (_explained(REASON_TEXT[code], _REASONS[code]), *_counted(site, site.summary.by_reason[code]))
        for code in Reason
        if site.summary.by_reason[code]
    ]
    if not rows:
        rows = [(_explained("none", "every tile with points has a class"), *_counted(site, 0))]
    return table("Why ground is not known", ("reason", "share", "area", "tiles"), rows)


_WHY = {
    Barred.NO: "the vehicle can cross it",
    Barred.UNKNOWN: "no class, or too little seen to tell whether there is a way: it must not be taken for drivable",
    Barred.OBSTACLE: "something stands in the way, or the vehicle does not fit between what stands there",
    Barred.SLOPE: "steeper than the vehicle may drive",
    Barred.FAILS: "at least half of the simulated drives rolled over or got stuck",
    Barred.STEP: "a step to or in the tile that the vehicle cannot climb",
    Barred.SPLIT: "obstacles part it, or part it from a passable tile beside it: routes pass on pixels",
}
_REASONS = {
    Reason.OK: "rated, but without a ride cost",
    Reason.NO_POINTS: "no point that counts",
    Reason.TOO_FEW_POINTS: "too few points to measure the ground",
    Reason.TOO_MANY_HOLES: "points are there, but large parts of the tile hold none",
    Reason.NO_GROUND: "points are there, but none of them is ground: trees, roofs",
    Reason.OUTLIER_RELIEF: "so many stray points that relief and noise cannot be told apart",
}


def _explained(name: str, meaning: str) -> Html:
    return join(name, tag("span", meaning, class_="meaning"))


def _counted(site: Site, tiles: int) -> tuple[str, str, str]:
    return share(tiles, site.summary.tiles), area(tiles * site.tile_area), whole(tiles)


def _class_counts(site: Site) -> list[int]:
    return [*site.summary.by_class, site.summary.unknown]


def _range(limits: tuple[float, ...], code: int) -> str:
    if len(limits) != len(CLASS_NAMES) - 1:
        return DASH
    if code == 0:
        return f"under {limits[0]:.3g}"
    return (
        f"{limits[-1]:.3g} and more, or steep, or drives fail"
        if code == len(limits)
        else f"{limits[code - 1]:.3g} to {limits[code]:.3g}"
    )


def _compared(caption: str, names: tuple[str, ...], counts: Callable[[Site], list[int]], sites: Sequence[Site]) -> Html:
    """Return a table of areas and shares of two maps, and by how many percentage points the share differs."""
    first, second = sites
    rows = []
    for name, one, two in zip(names[1:], counts(first), counts(second), strict=True):
        points = 100 * (two / max(second.summary.tiles, 1) - one / max(first.summary.tiles, 1))
        rows.append(
            (
                name,
                area(one * first.tile_area),
                share(one, first.summary.tiles),
                area(two * second.tile_area),
                share(two, second.summary.tiles),
                f"{points:+.1f}",
            )
        )
    head = (names[0], "A: area", "A: share", "B: area", "B: share", "B minus A, percentage points")
    return table(caption, head, rows, wide=True)
