"""The tables of a page: one column, or group of columns, for each map."""

from collections.abc import Callable, Collection, Sequence

from bumpymap.core import BARRED_TEXT, CLASS_NAMES, REASON_TEXT, Barred, Reason
from bumpymap.layers.report.markup import Html, join, table, tag
from bumpymap.layers.report.numbers import DASH, area, number, share, shares, whole
from bumpymap.layers.report.site import Site
from bumpymap.layers.ride_scale import class_ranges
from bumpymap.layers.summary import LITTLE_SEEN

__all__ = ["bar_table", "class_table", "reason_table"]


def class_table(sites: Sequence[Site]) -> Html:
    """Return the table of classes: limits, tiles, area, share, median ride cost and slope."""
    if len(sites) > 1:
        return _compared("Classes", ("class", *CLASS_NAMES, "not known"), _class_counts, sites)
    (site,) = sites
    summary, ranges = site.summary, class_ranges(site.record) or (DASH,) * len(CLASS_NAMES)
    counts = _class_counts(site)
    names = (*(f"{code} {name}" for code, name in enumerate(CLASS_NAMES)), "not known")
    columns = zip(_counted(site, counts, (len(CLASS_NAMES),)), summary.median_c_r, summary.median_slope, strict=True)
    rows = [
        (name, *cells, which, number(c_r, 3), number(slope, 1))
        for name, which, (cells, c_r, slope) in zip(names, (*ranges, DASH), columns, strict=True)
    ]
    rows.append(("all", *_counted(site, [summary.tiles])[0], "", "", ""))
    head = ("class", "share", "area", "tiles", "C_r, rad/m", "median C_r, rad/m", "median slope, °")
    told = table("Classes", head, rows, wide=True)
    if not summary.failing:
        return told
    few = (
        f"{whole(summary.failing)} of the tiles in class {len(CLASS_NAMES) - 1} have a lower C_r and are there because "
        "they are too steep or drives fail. The median leaves them out: their C_r is that of the drives that got "
        "through."
    )
    return join(told, tag("p", few, class_="note"))


def bar_table(sites: Sequence[Site]) -> Html:
    """Return the table of what the vehicle can cross, and what keeps it from the rest."""
    if len(sites) > 1:
        names = [name for name in _WHY if any(site.summary.crossing.get(name) for site in sites)]
        return _compared(
            "What can be crossed",
            ("ground", *names),
            lambda site: [site.summary.crossing.get(name, 0) for name in names],
            sites,
        )
    (site,) = sites
    found = site.summary.crossing
    rows = [
        (_explained(name, _WHY[name]), *cells)
        for name, cells in zip(found, _counted(site, list(found.values()), (0, 1)), strict=True)
        if found[name] or name == BARRED_TEXT[Barred.NO]
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
    codes = [code for code in Reason if site.summary.by_reason[code]]
    known = site.summary.tiles - site.summary.unknown
    counted = _counted(site, [*(site.summary.by_reason[code] for code in codes), known], (len(codes),))
    rows = [
        (_explained(REASON_TEXT[code], _REASONS[code]), *cells) for code, cells in zip(codes, counted, strict=False)
    ]
    if not rows:
        rows = [(_explained("none", "every tile with points has a class"), share(0, known), area(0.0), whole(0))]
    return table("Why ground is not known", ("reason", "share", "area", "tiles"), rows)


_WHY = {
    BARRED_TEXT[Barred.NO]: "the vehicle can cross it",
    BARRED_TEXT[Barred.UNKNOWN]: "no class: it must not be taken for drivable",
    LITTLE_SEEN: "it has a class, but too little was seen to tell whether there is a way for the vehicle",
    BARRED_TEXT[Barred.OBSTACLE]: "something stands in the way, or the vehicle does not fit between what stands there",
    BARRED_TEXT[Barred.SLOPE]: "steeper than the vehicle may drive",
    BARRED_TEXT[Barred.FAILS]: "at least half of the simulated drives rolled over or got stuck",
    BARRED_TEXT[Barred.STEP]: "a step to or in the tile that the vehicle cannot climb",
    BARRED_TEXT[Barred.SPLIT]: "obstacles part it, or part it from a passable tile beside it: routes pass on pixels",
}
_ALONE = (BARRED_TEXT[Barred.NO], BARRED_TEXT[Barred.UNKNOWN], "not known")
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


def _counted(site: Site, counts: Sequence[int], alone: Collection[int] = ()) -> list[tuple[str, str, str]]:
    """Return share, area and number of all parts of the tiles; see `shares`."""
    told = zip(shares(counts, alone), counts, strict=True)
    return [(part, area(tiles * site.tile_area), whole(tiles)) for part, tiles in told]


def _class_counts(site: Site) -> list[int]:
    return [*site.summary.by_class, site.summary.unknown]


def _shares(names: Sequence[str], counts: list[int], tiles: int) -> list[str]:
    """Return the shares of parts of a map's tiles; those told elsewhere too, and the rest, are rounded alone."""
    alone = {place for place, name in enumerate(names) if name in _ALONE} | {len(counts)}
    rest = tiles - sum(counts)
    return shares([*counts, rest], alone if rest else alone - {len(counts)})[: len(counts)]


def _compared(caption: str, names: tuple[str, ...], counts: Callable[[Site], list[int]], sites: Sequence[Site]) -> Html:
    """Return a table of areas and shares of two maps, and by how many percentage points the share differs."""
    first, second = sites
    rows = []
    found = (counts(first), counts(second))
    told = [_shares(names[1:], one, site.summary.tiles) for one, site in zip(found, sites, strict=True)]
    for name, one, two, *texts in zip(names[1:], *found, *told, strict=True):
        points = 100 * (two / max(second.summary.tiles, 1) - one / max(first.summary.tiles, 1))
        rows.append(
            (
                name,
                area(one * first.tile_area),
                texts[0],
                area(two * second.tile_area),
                texts[1],
                f"{points:+.1f}",
            )
        )
    head = (names[0], "A: area", "A: share", "B: area", "B: share", "B minus A, percentage points")
    return table(caption, head, rows, wide=True)
