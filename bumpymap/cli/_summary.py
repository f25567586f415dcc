"""The summary that ``map`` and ``demo`` print."""

from collections.abc import Iterator

from bumpymap.cli._text import ALREADY_DONE, Table, as_options, cell
from bumpymap.core import CLASS_NAMES, MapConfig, count_text, share_text, shares_text
from bumpymap.layers import MapSummary
from bumpymap.survey import MapResult, describe_lines, ground_line, outcome_of_run, unknown_line
from bumpymap.views import degrees_line

_TITLES = ("class", "tiles", "share", "median c_r (rad/m)", "median slope (deg)")


def map_lines(result: MapResult, config: MapConfig) -> Iterator[str | Table]:
    """Yield the result of a run in lines."""
    summary = result.summary
    if result.already_done:
        yield f"Already done: {config.out} {ALREADY_DONE}"
    which = outcome_of_run(result, config).measured
    rest = (
        f", {result.from_all:,} from all points: that part of the survey is not classified" if result.from_all else ""
    )
    yield (
        f"{count_text(result.points, 'point')}, {count_text(summary.tiles - result.from_all, 'tile')} of "
        f"{config.tile_size:g} m measured from {'all points' if which == 'points' else which}{rest}, "
        f"{sum(result.seconds.values()):.1f} s"
    )
    yield Table(_rows(summary), _TITLES)
    degrees, lines = degrees_line(summary.median_c_r[: len(CLASS_NAMES)]), describe_lines(result.lines)
    yield from filter(None, [degrees, _passable_line(summary), summary.seen.sentence])
    if summary.by_holes:
        share = share_text(summary.by_holes / summary.tiles, 1)
        yield (
            f"compat='paper': {share} of the tiles are class 3 because they have too few points, or more than 30 % of "
            "their pixels hold none, which says nothing of the ground: leave compat out on sparse surveys"
        )
    yield unknown_line(result, config)
    yield from filter(None, [ground_line(result), lines])
    if result.skipped:
        were = "was" if len(result.skipped) == 1 else "were"
        yield f"{count_text(len(result.skipped), 'input')} {were} skipped; run.json lists the reasons"
    for folder in sorted({path.parent for path in result.files}):
        names = (path.name for path in result.files if path.parent == folder and path.suffix != ".qml")
        yield f"Layers in {folder}: {', '.join(names)}"  # a style belongs to a layer


def _passable_line(summary: MapSummary) -> str:
    """Say which share of the tiles is passable, and what bars the others."""
    found = summary.crossing
    passable, *shares = shares_text(list(found.values()), (0, 1), 1)
    others = zip(list(found.items())[1:], shares, strict=True)
    bars = ", ".join(f"{text} {share}" for (text, count), share in others if count)
    line = f"{passable} of the tiles are passable"
    return f"{line}; what bars the others: {bars}" if bars else line


def _rows(summary: MapSummary) -> Iterator[tuple[str, ...]]:
    names = [*(f"{class_id} {name}" for class_id, name in enumerate(CLASS_NAMES)), "unknown"]
    counts = [*summary.by_class, summary.unknown]
    shares = shares_text(counts, (len(CLASS_NAMES),), 1)
    medians = zip(summary.median_c_r, summary.median_slope, strict=True)
    for name, count, share, (c_r, slope) in zip(names, counts, shares, medians, strict=True):
        if name == "unknown" and summary.failing:
            yield "  only too steep or drives fail", *_part(summary.failing, summary)
        if name == "unknown" and summary.by_holes:
            yield "  only by the paper's rule of holes", *_part(summary.by_holes, summary)
        yield name, f"{count:,}", share, cell(c_r, ".3f"), cell(slope, ".1f")
    reasons = summary.reasons
    shares = shares_text([*reasons.values(), summary.tiles - summary.unknown], (len(reasons),), 1)
    for (reason, count), share in zip(reasons.items(), shares, strict=False):
        yield f"  {reason}", f"{count:,}", share, "", ""


def _part(count: int, summary: MapSummary) -> tuple[str, str, str, str]:
    """Return the cells of a part of class 3: tiles and their share of all."""
    return f"{count:,}", share_text(count / summary.tiles, 1), "", ""


def map_record(result: MapResult, config: MapConfig) -> dict[str, object]:
    """Return the result of a run as an object of JSON."""
    return {
        "out": str(config.out),
        "files": [path.relative_to(config.out).as_posix() for path in result.files],
        "points": result.points,
        "tiles": result.summary.tiles,
        "classes": result.summary.classes,
        "unknown": result.summary.reasons,
        "passable": result.summary.passable,
        "barred": result.summary.bars,
        "seen_sizes": result.summary.seen.record(),
        "unknown_share": result.summary.unknown / result.summary.tiles,
        "advice": unknown_line(result, config),
        "ground_advice": as_options(ground_line(result)),
        "ground_only": result.ground_only,
        "tiles_from_all_points": result.from_all,
        "flight_lines": describe_lines(result.lines),
        "skipped": result.skipped,
        "seconds": result.seconds,
        "already_done": result.already_done,
    }
