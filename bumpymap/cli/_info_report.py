"""The report of ``bumpymap info`` about one survey, and the estimate of a run."""

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.filesize import decimal

from bumpymap.cli._text import Styled, Table, about, as_options
from bumpymap.core import (
    GROUND_CLASSES,
    REASON_TEXT,
    BadInputError,
    FeatureSettings,
    Georeference,
    Ground,
    MapConfig,
    common_georeference,
    count_text,
    decide_ground,
    describe_crs,
    horizontal_of,
    parse_crs,
    same_crs,
    unit_name,
    vertical_of,
)
from bumpymap.layers import MAX_TILES, fits_one_map, suggested_sheets
from bumpymap.readers import PointSummary, PointSummaryBuilder, SurveyInfo
from bumpymap.survey import (
    Budget,
    Estimate,
    FlightLines,
    Outcome,
    advise,
    compare_lines,
    describe_lines,
    describe_pairs,
    enough_points,
    estimate,
    models_for,
    size_options,
)
from bumpytiles import Bounds, Grid, TileWindow

__all__ = ["Report", "map_options", "report_lines", "report_record"]

_CLASS_NAMES = {
    0: "never classified",
    1: "unassigned",
    2: "ground",
    3: "low plants",
    4: "medium plants",
    5: "high plants",
    6: "building",
    8: "key point",
    9: "water",
    10: "rail",
    11: "road",
    12: "overlap",
    13: "wire guard",
    14: "wire",
    15: "tower",
    16: "wire connector",
    17: "bridge deck",
}
_ON_THE_GROUND = "all points will be measured, so what stands on the ground is part of its relief"
_FAR_APART = 100_000.0
"""Longest plausible side of a survey by drone, or of a tile of an airborne survey, m."""


@dataclass(frozen=True, slots=True)
class Report:
    """The report about one file: from its header and its points, or why it cannot be read."""

    path: Path | str
    grid: Grid
    info: SurveyInfo | None = None
    summary: PointSummary | None = None
    """None with ``--quick``, and if no point is left."""
    dropped: dict[str, int] | None = None
    """Number of dropped points by reason; None with ``--quick``."""
    classes: dict[int, int] = field(default_factory=dict)
    """Number of points of each LAS class; empty with ``--quick``."""
    error: str = ""
    options: tuple[str, ...] = ()
    """Options of the command line that ``map`` needs too, such as ``--crs EPSG:32614``."""
    config: MapConfig = MapConfig((), Path())  # noqa: RUF009 (frozen)
    """Settings for ``map``."""
    lines: FlightLines = FlightLines()  # noqa: RUF009 (frozen)
    """Height steps between flight lines; without ``--quick``."""

    @property
    def bounds(self) -> Bounds | None:
        """Bounds of the points if they were read, else of the header, m."""
        if self.summary is not None:
            return self.summary.bounds
        return self.info.bounds if self.info else None

    @property
    def density(self) -> float | None:
        """Points per square metre: in the median tile, or the number in the header over its extent."""
        if self.summary is not None:
            return self.summary.density
        bounds = self.bounds
        area = (bounds.east - bounds.west) * (bounds.north - bounds.south) if bounds else 0.0
        return self.info.point_count / area if self.info and area > 0 else None

    @property
    def outcome(self) -> Outcome | None:
        """Forecast of the tiles that ``bumpymap map`` will make; None if the points were not read."""
        return _outcome_of(self.summary, self.config.ground) if self.summary is not None else None

    @property
    def sheets(self) -> float | None:
        """Side of the sheets that ``map`` should write, km; None if one map can hold all tiles."""
        return _sheets_for(self.grid, [self.bounds])

    def needs(self) -> list[str]:
        """Return what ``bumpymap map`` needs for this file, or the command to map it; one sentence each."""
        if self.info is None:
            return [self.error]
        lines: list[str] = []
        if self.info.georeference.crs is None:
            lines.append("no CRS: pass --crs EPSG:CODE, or --local to map it in its own coordinates")
        if self.dropped is not None and self.summary is None:
            lines.append("no usable points (all are withheld, noise or without return): nothing to map")
        lines += self._spread() + self._unknown()
        if size_options(self.grid):
            lines.append(
                f"tiles of {self.grid.tile_size:g} m with {self.grid.pixels} pixels need {models_for(self.grid)}"
            )
        summary = self.summary
        if (
            summary
            and summary.ground_tiles
            and self.config.ground == "auto"
            and _outcome_of(summary).measured == "points"
        ):
            share = summary.ground_tiles / summary.tiles
            lines.append(f"ground points in only {share:.0%} of tiles: --ground auto will use all points")
        return lines or [self._ready()]

    def _ready(self) -> str:
        words = ["bumpymap", "map", str(self.path), *self.options, *_sheet_options(self.sheets), "--out", "DIR"]
        few = f", about {self.outcome.share:.0%} of the tiles will be unknown" if self.outcome else ""
        return f"ready{few}: {shlex.join(words)}"

    def _unknown(self) -> list[str]:
        """Return the share of unknown tiles and advice; from a header alone, whether there are enough points."""
        settings = FeatureSettings()
        if self.outcome is not None:
            text = advise(self.outcome, self.grid, settings, before_run=True)
            return [text] if text else []
        if self.dropped is not None or self.density is None:
            return []
        per_tile, enough = self.density * self.grid.tile_size**2, enough_points(self.grid, settings, thin=True)
        if per_tile >= enough:
            return []
        text = (
            f"according to the header there are {per_tile:.0f} points per {self.grid.tile_size:g} m tile, and about "
            f"{enough} are needed: most tiles will be unknown. Run without --quick to see how many, and what would help"
        )
        return [text]

    def _spread(self) -> list[str]:
        bounds = self.bounds
        side = max(bounds.east - bounds.west, bounds.north - bounds.south) if bounds else 0.0
        if side <= _FAR_APART:
            return []
        return [
            f"its points are spread over {side / 1000:,.0f} km: there may be stray coordinates, or the CRS may be wrong"
        ]


def map_options(config: MapConfig, place: Georeference) -> Iterator[str]:
    """Yield the options that ``map`` needs too: ``--crs`` only for a survey that has none."""
    if config.crs is not None:
        flat, own = horizontal_of(parse_crs(config.crs)), place.crs and horizontal_of(place.crs)
        if flat is not None and own is not None and same_crs(flat, own):
            yield from ("--crs", config.crs)
    if config.force_crs is not None:
        yield from ("--set", f"force_crs={config.force_crs}")
    if config.z_unit is not None:
        yield from ("--z-unit", config.z_unit)
    if config.trust_points:
        yield from ("--set", "trust_points=true")
    if config.ground != "auto":
        yield from ("--ground", config.ground)
    if config.ground_classes != GROUND_CLASSES:
        yield from ("--ground-classes", ",".join(map(str, config.ground_classes)))


def report_record(reports: Sequence[Report], budget: Budget) -> dict[str, Any]:
    """Return everything about files and a run over them, for ``--json``."""
    together, forecast = _why_not_together(reports), _estimated(reports, budget)
    return {
        "files": [_as_record(report) for report in reports],
        "together": " ".join(together),
        "sheets_km": _sheets_for(reports[0].grid, [report.bounds for report in reports]),
        "run": None if forecast is None else _run_record(forecast, budget),
    }


def report_lines(
    reports: Sequence[Report],
    budget: Budget,
    surveys: Sequence[Path | str],
    memory: str,
    whole: PointSummaryBuilder | None,
) -> Iterator[str | Styled | Table]:
    """Yield the report in lines.

    Parameters
    ----------
    reports : sequence of Report
    budget : Budget
    surveys : sequence of Path or str
        Files and folders that the user named.
    memory : str
        The setting ``memory``, for the line about a run.
    whole : PointSummaryBuilder or None
        All files together, if their points were read.
    """
    grid = reports[0].grid
    for report in reports:
        yield Styled(str(report.path), "bold")
        yield Table(_as_rows(report))
        # Not in the table, which would wrap commands: they must stay on one line to be copied.
        label = "error" if report.error else "to map it"
        yield from (Styled(need, "yellow", f"  {label}: ") for need in report.needs())
        yield ""
    together = _why_not_together(reports) or _advise_one_map(surveys, reports, whole)
    yield from (Styled(line if number else f"together: {line}", "bold") for number, line in enumerate(together))
    forecast = _estimated(reports, budget)
    if forecast is not None:
        threads = count_text(budget.threads, "thread")
        yield Styled(f"a run with --memory {memory} on {threads}", "bold")
        yield Table(_run_rows(forecast, grid))
        sheets = _sheets_for(grid, [report.bounds for report in reports])
        if sheets is not None:
            text = f"it spans more than the {MAX_TILES:,} tiles of one map: --sheets {sheets:g} writes it in several"
            yield Styled(f"{text} folders", "yellow", "  sheets: ")


def _why_not_together(reports: Sequence[Report]) -> list[str]:
    """Return why the files cannot be mapped in one run, in lines; empty if they can."""
    infos = [report.info for report in reports if report.info is not None]
    try:
        if infos:
            common_georeference(infos)
    except BadInputError as error:
        return [str(line) for line in error.args]
    return []


def _advise_one_map(
    surveys: Sequence[Path | str], reports: Sequence[Report], whole: PointSummaryBuilder | None
) -> list[str]:
    """Return the command that maps several files together, and advice; empty for one file, or if one is bad."""
    infos = [report.info for report in reports if report.info is not None and not report.error]
    if len(reports) == 1 or len(infos) < len(reports):
        return []
    points = sum(info.point_count for info in infos)
    sheets = _sheet_options(_sheets_for(reports[0].grid, [report.bounds for report in reports]))
    command = shlex.join(["bumpymap", "map", *map(str, surveys), *reports[0].options, *sheets, "--out", "DIR"])
    text = f"{count_text(len(reports), 'file')}, {count_text(points, 'point')}, one map: {command}"
    summary = None if whole is None else whole.summary()
    if whole is None or summary is None:
        return [text]
    outcome = _outcome_of(summary, reports[0].config.ground)
    advice = advise(outcome, reports[0].grid, FeatureSettings(), before_run=True)
    steps = describe_lines(compare_lines(whole.lines), "report")
    return [advice or f"about {outcome.share:.0%} of the tiles will be unknown", *filter(None, [steps]), text]


def _sheets_for(grid: Grid, boxes: Sequence[Bounds | None]) -> float | None:
    """Return the side of sheets, km, for points in these boxes; None if one map can hold them, or no box is known."""
    known = [box for box in boxes if box is not None]
    if not known:
        return None
    size = grid.tile_size
    west, south = (int(min(sides) // size) for sides in ([b.west for b in known], [b.south for b in known]))
    east, north = (int(max(sides) // size) for sides in ([b.east for b in known], [b.north for b in known]))
    window = TileWindow(west, south, east - west + 1, north - south + 1)
    return None if fits_one_map(grid, window) else suggested_sheets(grid)


def _sheet_options(sheets: float | None) -> tuple[str, ...]:
    """Return the options of ``map`` for sheets of this side."""
    return () if sheets is None else ("--sheets", f"{sheets:g}")


def _outcome_of(summary: PointSummary, ground: Ground = "auto") -> Outcome:
    """Forecast the tiles that ``map`` will make with the rating of a vehicle that is included."""
    # Without class 2 although it is required: map will raise an error, info reports that all tiles lack ground.
    ground_only = ground == "class" or decide_ground(ground, summary.tiles, summary.ground_tiles)
    return Outcome(
        tiles=summary.tiles,
        unknown=summary.ground_unknown if ground_only else summary.unknown,
        measured="ground points" if ground_only else "points",
        points_per_tile=summary.ground_points_per_tile if ground_only else summary.points_per_tile,
        all_points_per_tile=summary.points / summary.tiles,
        thin=True,
    )


def _as_record(report: Report) -> dict[str, Any]:
    """Return everything about one file, for ``--json``."""
    info, summary = report.info, report.summary
    if info is None:
        return {"path": str(report.path), "error": report.error}
    place = info.georeference
    horizontal, vertical = (of(place.crs) if place.crs else None for of in (horizontal_of, vertical_of))
    record: dict[str, Any] = {
        "path": str(report.path),
        "format": info.format,
        "size_bytes": info.size_bytes,
        "points_promised": info.point_count,
        "header_date": info.header_date and info.header_date.isoformat(),
        "crs": horizontal.name if horizontal else None,
        "epsg": horizontal.to_epsg() if horizontal else None,
        "vertical_crs": vertical.name if vertical else None,
        "metres_per_unit": place.metres_per_unit,
        "metres_per_unit_z": place.metres_per_unit_z,
        "bounds_m": _sides(report.bounds, 1.0),
        "bounds_crs_units": _sides(report.bounds, place.metres_per_unit),
        "density_per_m2": report.density,
        "has_classes": _has_classes(report),
        "classes": {str(code): count for code, count in report.classes.items()},
        "sheets_km": report.sheets,
        "notes": list(info.notes),
        "needs": report.needs(),
    }
    if summary is not None:
        record |= {
            "points": summary.points,
            "z_m": [summary.z_min, summary.z_max],
            "tile_size_m": report.grid.tile_size,
            "tiles": summary.tiles,
            "points_per_tile": summary.points_per_tile,
            "ground_points": summary.ground_share,
            "ground_tiles": summary.ground_tiles / summary.tiles,
            "unknown_tiles_about": _shares(_outcome_of(summary, report.config.ground)),
            "flight_lines": report.lines.to_record(),
        }
    return record if report.dropped is None else record | {"dropped": report.dropped}


def _shares(outcome: Outcome) -> dict[str, float]:
    """Return the shares of the tiles that will be unknown, by reason."""
    return {REASON_TEXT[reason]: count / outcome.tiles for reason, count in outcome.unknown.items() if count}


def _as_rows(report: Report) -> list[tuple[str, str]]:
    """Return the facts about one file as (name, text); empty if it cannot be read."""
    info, summary = report.info, report.summary
    if info is None:
        return []
    place, bounds = info.georeference, report.bounds
    units = unit_name(place.metres_per_unit)
    if place.metres_per_unit_z != place.metres_per_unit:
        units += f", heights in {unit_name(place.metres_per_unit_z)}"
    rows = [
        ("format", f"{info.format}; {decimal(info.size_bytes)}"),
        ("points", _points(report)),
        ("CRS", describe_crs(place.crs) if place.crs else "none"),
        ("units", units),
    ]
    if info.header_date is not None:
        rows.append(("date in header", f"{info.header_date.isoformat()}: of the flight or of processing"))
    if bounds is not None:
        if place.metres_per_unit != 1.0:
            rows.append(("extent, CRS units", _extent(bounds, place.metres_per_unit)))
        rows.append(("extent, m", _extent(bounds, 1.0)))
        rows.append(("size", _size(bounds, summary)))
    if report.density is not None:
        rows.append(("density", _density(report, report.density)))
    if report.dropped is not None or info.has_classes is False:
        rows.append(("classified", _classified(report)))
    if report.summary is not None and report.summary.ground_share > 0:
        rows += _classes(report)
    if text := describe_pairs(report.lines):
        rows.append(("flight lines", as_options(text)))
    return rows + [("note", note) for note in info.notes]


def _estimated(reports: Sequence[Report], budget: Budget) -> Estimate | None:
    """Estimate one run over all files that can be read; None if there are none, or they cannot be mapped together."""
    readable = [report for report in reports if report.info is not None]
    if not readable or _why_not_together(reports):
        return None
    counted = [report.summary.tiles for report in readable if report.summary is not None]
    tiles = sum(counted) if len(counted) == len(readable) else None
    return estimate([report.info for report in readable if report.info], readable[0].grid, budget, tiles)


def _run_record(forecast: Estimate, budget: Budget) -> dict[str, Any]:
    """Return everything about the run, for ``--json``."""
    return {
        "memory_option_bytes": budget.memory,
        "threads": budget.threads,
        "points": forecast.points,
        "tiles_at_most": forecast.tiles,
        "memory_bytes_at_most": forecast.memory,
        "scratch_bytes_at_most": forecast.scratch,
        "out_bytes_at_most": forecast.out,
        "seconds_about": round(forecast.seconds, 1),
    }


def _run_rows(forecast: Estimate, grid: Grid) -> list[tuple[str, str]]:
    """Return the needs of a run as (name, text)."""
    unknown = "unknown until the points are read: run without --quick"
    scratch = (
        f"at most {decimal(forecast.scratch)} in the folder for points (scratch); less if blocks are complete early"
    )
    out = None if forecast.out is None else f"at most {decimal(forecast.out)} in --out: finished tiles, and the layers"
    return [
        ("points", f"{forecast.points:,}"),
        ("tiles", unknown if forecast.tiles is None else f"at most {forecast.tiles:,} of {grid.tile_size:g} m"),
        ("memory", f"at most {decimal(forecast.memory)}"),
        ("scratch", scratch if forecast.scratch else "none: all points fit into memory"),
        ("space", out or unknown),
        ("time", about(forecast.seconds)),
    ]


def _points(report: Report) -> str:
    if report.info is None or report.dropped is None:
        return f"{report.info.point_count if report.info else 0:,} according to the header"
    left_out = [f"{count:,} {reason.replace('_', ' ')}" for reason, count in report.dropped.items() if count]
    counted = report.summary.points if report.summary else 0
    return f"{counted:,}" + (f"; excluded: {', '.join(left_out)}" if left_out else "")


def _extent(bounds: Bounds, unit: float) -> str:
    west, south, east, north = (side / unit for side in (bounds.west, bounds.south, bounds.east, bounds.north))
    return f"easting {west:,.2f} to {east:,.2f}, northing {south:,.2f} to {north:,.2f}"


def _size(bounds: Bounds, summary: PointSummary | None) -> str:
    sides = f"{bounds.east - bounds.west:,.1f} m x {bounds.north - bounds.south:,.1f} m"
    return sides + (f", heights {summary.z_min:,.2f} to {summary.z_max:,.2f} m" if summary else "")


def _density(report: Report, density: float) -> str:
    tile = f"{report.grid.tile_size:g} m tile"
    if report.summary is None:
        return f"{_short(density)} pts/m2 in the header's extent: {density * report.grid.tile_size**2:.0f} per {tile}"
    summary = report.summary
    tiles = count_text(summary.tiles, "tile")
    return f"{_short(density)} pts/m2: {summary.points_per_tile:.0f} points per {tile} (median of {tiles})"


def _has_classes(report: Report) -> bool | None:
    if report.summary is not None and report.summary.ground_share > 0:
        return True
    return report.info.has_classes if report.info else None


def _classes(report: Report) -> list[tuple[str, str]]:
    """Return the classes of a classified survey by what `map` takes their points for."""
    points = max(1, sum(report.classes.values()))
    taken = {6: "as obstacles"} | dict.fromkeys(report.config.ground_classes, "as ground")
    rows: dict[str, list[str]] = {}
    for code, count in report.classes.items():
        named = " ".join(filter(None, (str(code), _CLASS_NAMES.get(code))))
        rows.setdefault(taken.get(code, "by height"), []).append(f"{named} {count / points:.1%}")
    texts = {name: ", ".join(parts) for name, parts in rows.items()}
    if "by height" in texts:
        texts["by height"] += ": obstacle or canopy, and if no ground is seen beneath, obstacle"
    return list(texts.items())


def _classified(report: Report) -> str:
    if report.info is not None and report.info.has_classes is False:
        return f"no: the file has no classes; {_ON_THE_GROUND}"
    if report.summary is None or report.summary.ground_share == 0:
        return f"no: no point is of a ground class; {_ON_THE_GROUND}"
    return f"yes: {report.summary.ground_share:.0%} of the points are ground"


def _sides(bounds: Bounds | None, unit: float) -> tuple[float, float, float, float] | None:
    if bounds is None:
        return None
    return bounds.west / unit, bounds.south / unit, bounds.east / unit, bounds.north / unit


def _short(density: float) -> str:
    return f"{density:.1f}" if density >= 0.1 else f"{density:.1g}"
