"""The report of ``bumpymap info`` about one survey, and the estimate of a run."""

import math
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from rich.filesize import decimal

from bumpymap.cli._output import Styled, Table, about, as_options
from bumpymap.core import (
    GROUND_CLASSES,
    INCLUDED_PIXELS,
    REASON_TEXT,
    BadInputError,
    FeatureSettings,
    Georeference,
    Ground,
    MapConfig,
    Reason,
    SeenSizes,
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
from bumpymap.layers import check_extent
from bumpymap.readers import PointSummary, PointSummaryBuilder, SurveyInfo
from bumpymap.survey import (
    Budget,
    Estimate,
    FlightLines,
    Outcome,
    advise,
    compare_lines,
    describe_lines,
    enough_points,
    estimate,
    file_doubts,
)
from bumpytiles import Bounds, Grid, TileWindow


@dataclass(frozen=True, slots=True)
class FileReport:
    """One file: what is known from its header and its points, or why it cannot be read."""

    path: Path
    info: SurveyInfo | None = None
    summary: PointSummary | None = None
    """None with ``--quick``, and if no point is left."""
    dropped: dict[str, int] | None = None
    """Number of dropped points by reason; None with ``--quick``."""
    error: str = ""
    lines: FlightLines = FlightLines()  # noqa: RUF009 (frozen)
    """Height steps between flight lines; without ``--quick``."""

    @property
    def bounds(self) -> Bounds | None:
        """Bounds of the points if they were read, else of the header, m."""
        if self.summary is not None:
            return self.summary.bounds
        return self.info.bounds if self.info is not None else None

    @property
    def density(self) -> float | None:
        """Points per square metre: in the median tile, or the number in the header over its extent."""
        if self.summary is not None:
            return self.summary.density
        box = self.bounds
        area = (box.east - box.west) * (box.north - box.south) if box else 0.0
        return self.info.point_count / area if self.info and area > 0 else None

    @property
    def has_ground(self) -> bool:
        """True if ground points were read."""
        return self.summary is not None and self.summary.ground_share > 0


@dataclass(frozen=True, slots=True)
class Report:
    """The files that were looked at, and the settings of a run over them."""

    files: Sequence[FileReport]
    config: MapConfig
    budget: Budget
    memory: str
    """The setting ``memory``, for the line about a run."""
    whole: PointSummaryBuilder | None
    """All files together, if their points were read."""

    def lines(self) -> Iterator[str | Styled | Table]:
        """Yield the report in lines."""
        for file in self.files:
            yield Styled(str(file.path), "bold")
            yield Table(self._rows(file))
            # Not in the table, which would wrap commands: they must stay on one line to be copied.
            label = "error" if file.error else "to map it"
            yield from (Styled(need, "yellow", f"  {label}: ") for need in self._needs(file))
            yield ""
        if self.config.photo is not None:
            yield Styled(f"orthophoto: {self.config.photo}", "bold")
        together = self._why_not_together() or self._one_map()
        yield from (Styled(line if number else f"together: {line}", "bold") for number, line in enumerate(together))
        yield from (Styled(as_options(doubt), "yellow", "  doubtful: ") for doubt in self._doubts())
        forecast = self._estimate()
        if forecast is not None:
            threads = count_text(self.budget.threads, "thread")
            yield Styled(f"a run with --memory {self.memory} on {threads}", "bold")
            yield Table(_run_rows(forecast, self.config.grid))
            if why := self._too_large():
                yield Styled(as_options(why), "yellow", "  too large: ")

    def record(self) -> dict[str, Any]:
        """Return everything about the files and a run over them, for ``--json``."""
        forecast = self._estimate()
        return {
            "files": [self._record(file) for file in self.files],
            "photo": self.config.photo and str(self.config.photo),
            "together": " ".join(self._why_not_together()),
            "doubts": [as_options(doubt) for doubt in self._doubts()],
            "too_large": as_options(self._too_large()),
            "run": forecast
            and {
                "memory_option_bytes": self.budget.memory,
                "threads": self.budget.threads,
                "points": forecast.points,
                "tiles_at_most": forecast.tiles,
                "memory_bytes_at_most": forecast.memory,
                "scratch_bytes_at_most": forecast.scratch,
                "out_bytes_at_most": forecast.out,
                "seconds_about": round(forecast.seconds, 1),
            },
        }

    def _needs(self, file: FileReport) -> list[str]:
        """Return what ``bumpymap map`` needs for a file, or the command to map it; one sentence each."""
        if file.info is None:
            return [file.error]
        lines: list[str] = []
        if file.info.georeference.crs is None:
            lines.append("no CRS: pass --crs EPSG:CODE, or --local to map it in its own coordinates")
        if file.dropped is not None and file.summary is None:
            lines.append("no usable points (all are withheld, noise or without return): nothing to map")
        lines += self._unknown(file)
        grid = self.config.grid
        if INCLUDED_PIXELS.get(grid.tile_size) != grid.pixels:
            lines.append(
                f"tiles of {grid.tile_size:g} m with {grid.pixels} pixels need a calibration that drives patches of "
                f"that size: bumpymap calibrate --vehicle NAME_OR_FILE --tile-size {grid.tile_size:g} --set "
                f"pixels={grid.pixels} --out my.json; then bumpymap map --calibration my.json"
            )
        if lines:
            return lines
        outcome = self._outcome(file.summary)
        few = f", about {outcome.share:.0%} of the tiles will be unknown" if outcome else ""
        ready = f"ready{few}: {self._command([file.path], [file])}"
        if file.summary is None or file.summary.unseen <= _MANY_UNSEEN:
            return [ready]
        unseen = (
            f"about {file.summary.unseen:.0%} of the tiles hold so few points that they get a class, but no way "
            "through them: objects there are not seen"
        )
        return [unseen, ready]

    def _unknown(self, file: FileReport) -> list[str]:
        """Return the share of unknown tiles and advice; from a header alone, whether there are enough points."""
        settings, size = FeatureSettings(), self.config.grid.tile_size
        if file.summary is not None:
            return [*filter(None, [self._advice(file.summary)])]
        enough = enough_points(settings, thin=True)
        if file.dropped is not None or file.density is None or file.density * size**2 >= enough:
            return []
        text = (
            f"according to the header there are {file.density * size**2:.0f} points per {size:g} m tile, and {enough} "
            "are needed: most tiles will be unknown. Run without --quick to see how many"
        )
        return [text]

    def _advice(self, summary: PointSummary) -> str:
        """Return the share of unknown tiles and what would leave far fewer; empty if there are few."""
        outcome = self._outcome(summary)
        return advise(outcome, FeatureSettings(), would_help=self._alternatives(summary)) if outcome else ""

    def _alternatives(self, summary: PointSummary) -> dict[str, float]:
        """Return the share of unknown tiles with options that may leave fewer."""
        others = {"--ground all": self._outcome(summary, "all")}
        if summary.doubled is not None:
            others[f"--tile-size {2.0 * self.config.grid.tile_size:g}"] = self._outcome(summary.doubled)
        return {option: other.share for option, other in others.items() if other is not None}

    def _outcome(self, summary: PointSummary | None, ground: Ground | None = None) -> Outcome | None:
        """Forecast the tiles that ``map`` will make with the rating of a vehicle that is included.

        ``ground``: instead of that of the settings. Nobody knows before what the cloth will find.
        """
        ground = ground or self.config.ground
        if summary is None or ground == "csf":
            return None
        # Without ground points although they are required, map ends with an error; here all tiles lack ground.
        apart = summary.never_classified if ground == "auto" else 0
        ground_only = ground == "class" or decide_ground(ground, summary.tiles - apart, summary.ground_tiles)
        unknown = dict(summary.ground_unknown if ground_only else summary.unknown)
        if ground_only and apart:
            unknown[Reason.NO_GROUND] = max(0.0, unknown[Reason.NO_GROUND] - apart)
            for reason, count in summary.unknown.items():
                unknown[reason] += count * apart / summary.tiles
        return Outcome(
            tiles=summary.tiles,
            unknown=unknown,
            measured="ground points" if ground_only else "points",
            points_per_tile=summary.ground_points_per_tile if ground_only else summary.points_per_tile,
            all_points_per_tile=summary.points / summary.tiles,
            thin=True,
        )

    def _command(self, surveys: Sequence[Path], files: Sequence[FileReport]) -> str:
        """Return the command that maps files; ``--crs`` only for surveys that have none."""
        place = next((file.info.georeference for file in files if file.info), None)
        words = ["bumpymap", "map", *map(str, surveys), *_map_options(self.config, place), "--out", "DIR"]
        return shlex.join(words)

    def _too_large(self) -> str:
        """Return why one map cannot hold the files; empty if it can, or no bounds are known."""
        known, size = [file.bounds for file in self.files if file.bounds is not None], self.config.grid.tile_size
        if not known:
            return ""
        west, south = (int(min(sides) // size) for sides in ([b.west for b in known], [b.south for b in known]))
        east, north = (int(max(sides) // size) for sides in ([b.east for b in known], [b.north for b in known]))
        window = TileWindow(west, south, east - west + 1, north - south + 1)
        try:
            check_extent(self.config.grid, window)
        except BadInputError as error:
            return str(error)
        return ""

    def _doubts(self) -> list[str]:
        """Return what the extents and heights of the files make doubtful."""
        infos = [replace(file.info, bounds=file.bounds) for file in self.files if file.info is not None]
        return file_doubts(infos)

    def _why_not_together(self) -> list[str]:
        """Return why the files cannot be mapped in one run, in lines; empty if they can."""
        infos = [file.info for file in self.files if file.info is not None]
        try:
            if infos:
                common_georeference(infos)
        except BadInputError as error:
            return [str(line) for line in error.args]
        return []

    def _one_map(self) -> list[str]:
        """Return the command that maps several files together, and advice; empty for one, or if one is bad."""
        if len(self.files) == 1 or any(file.error for file in self.files):
            return []
        points = sum(file.info.point_count for file in self.files if file.info)
        command = self._command(self.config.surveys, self.files)
        text = f"{count_text(len(self.files), 'file')}, {count_text(points, 'point')}, one map: {command}"
        summary = self.whole.summary() if self.whole else None
        outcome = self._outcome(summary)
        if self.whole is None or summary is None:
            return [text]
        steps = describe_lines(compare_lines(self.whole.lines))
        few = f"about {outcome.share:.0%} of the tiles will be unknown" if outcome else ""
        return [*filter(None, [self._advice(summary) or few, self._apart(summary), steps]), text]

    def _apart(self, summary: PointSummary | None) -> str:
        """Say how many tiles of a classified survey are of a part that is not; empty if none is."""
        if summary is None or not summary.never_classified or self.config.ground != "auto":
            return ""
        about = f"about {count_text(summary.never_classified, 'tile')} of {summary.tiles:,}"
        return f"{about} are of a part that is not classified: all of its points will be measured"

    def _estimate(self) -> Estimate | None:
        """Estimate one run over all files that can be read; None if there are none, or no run can map them together."""
        infos = [file.info for file in self.files if file.info is not None]
        if not infos or self._why_not_together():
            return None
        counted = [file.summary.tiles for file in self.files if file.summary is not None]
        return estimate(infos, self.config.grid, self.budget, sum(counted) if len(counted) == len(infos) else None)

    def _record(self, file: FileReport) -> dict[str, Any]:
        """Return everything about one file, for ``--json``."""
        info, summary = file.info, file.summary
        if info is None:
            return {"path": str(file.path), "error": file.error}
        place, box = info.georeference, file.bounds
        horizontal, vertical = (of(place.crs) if place.crs else None for of in (horizontal_of, vertical_of))
        sides = box and (box.west, box.south, box.east, box.north)
        record: dict[str, Any] = {
            "path": str(file.path),
            "format": info.format,
            "size_bytes": info.size_bytes,
            "points_promised": info.point_count,
            "header_date": info.header_date and info.header_date.isoformat(),
            "crs": horizontal.name if horizontal else None,
            "epsg": horizontal.to_epsg() if horizontal else None,
            "vertical_crs": vertical.name if vertical else None,
            "metres_per_unit": place.metres_per_unit,
            "unit_assumed": place.assumed,
            "metres_per_unit_z": place.metres_per_unit_z,
            "bounds_m": sides,
            "bounds_crs_units": sides and tuple(side / place.metres_per_unit for side in sides),
            "density_per_m2": file.density,
            **({} if file.density is None else {"seen_sizes": self._seen(file).record()}),
            "has_classes": file.has_ground or info.has_classes,
            "classes": {str(code): points for code, (points, _, _) in summary.classes.items()} if summary else {},
            "class_names": {str(code): name for code, name in info.class_names.items()},
            "notes": list(info.notes),
            "needs": self._needs(file),
        }
        outcome = self._outcome(summary)
        if summary is not None and outcome is not None:
            unknown = {REASON_TEXT[reason]: count / outcome.tiles for reason, count in outcome.unknown.items() if count}
            record |= {
                "points": summary.points,
                "z_m": [summary.z_min, summary.z_max],
                "tile_size_m": self.config.grid.tile_size,
                "tiles": summary.tiles,
                "points_per_tile": summary.points_per_tile,
                "ground_points": summary.ground_share,
                "ground_tiles": summary.ground_tiles / summary.tiles,
                "never_classified_tiles": summary.never_classified / summary.tiles,
                "unknown_tiles_about": unknown,
                "unknown_tiles_with": self._alternatives(summary),
                "class_tiles": {str(code): round(share, 4) for code, (_, share, _) in summary.classes.items()},
                "class_heights_m": {
                    str(code): None if math.isnan(height) else round(height, 3)
                    for code, (_, _, height) in summary.classes.items()
                },
                "flight_lines": asdict(file.lines),
            }
        return record if file.dropped is None else record | {"dropped": file.dropped}

    def _rows(self, file: FileReport) -> list[tuple[str, str]]:
        """Return the facts about one file as (name, text); empty if it cannot be read."""
        info, summary, box = file.info, file.summary, file.bounds
        if info is None:
            return []
        place = info.georeference
        points = f"{info.point_count:,} according to the header"
        if file.dropped is not None:
            left_out = [f"{count:,} {reason.replace('_', ' ')}" for reason, count in file.dropped.items() if count]
            excluded = f"; excluded: {', '.join(left_out)}" if left_out else ""
            points = f"{summary.points if summary else 0:,}{excluded}"
        rows = [
            ("format", f"{info.format}; {decimal(info.size_bytes)}"),
            ("points", points),
            ("CRS", describe_crs(place.crs) if place.crs else "none"),
            ("units", _units(place)),
        ]
        if info.header_date is not None:
            rows.append(("date in header", f"{info.header_date.isoformat()}: of the flight or of processing"))
        if box is not None:
            across = f"easting {box.west:,.2f} to {box.east:,.2f}, northing {box.south:,.2f} to {box.north:,.2f}"
            sides = f"{box.east - box.west:,.1f} m x {box.north - box.south:,.1f} m"
            heights = f", heights {summary.z_min:,.2f} to {summary.z_max:,.2f} m" if summary else ""
            rows += [("extent, m", across), ("size", sides + heights)]
        if file.density is not None:
            rows.append(("density", self._density(file.density, summary)))
            rows.append(("not seen", self._seen(file).sentence))
        if file.dropped is not None or info.has_classes is False:
            rows += _classified(file, self.config.ground_classes)
        if apart := self._apart(summary):
            rows.append(("not classified", apart))
        if text := describe_lines(file.lines):
            rows.append(("flight lines", as_options(text.removeprefix("Flight lines: "))))
        return rows + [("note", note) for note in info.notes]

    def _seen(self, file: FileReport) -> SeenSizes:
        """Forecast the narrowest standing object that the survey shows, if its points lie evenly."""
        outcome, ground = self._outcome(file.summary), self.config.ground
        told_apart = ground == "csf" or (outcome is not None and outcome.measured == "ground points")
        most = math.inf if file.info is None else file.info.most_seen
        density = min(file.density or math.nan, most)
        return SeenSizes.forecast(density, self.config.grid.pixel_size, in_relief=not told_apart)

    def _density(self, density: float, summary: PointSummary | None) -> str:
        short = f"{density:.1f}" if density >= 0.1 else f"{density:.1g}"
        size = self.config.grid.tile_size
        if summary is None:
            return f"{short} pts/m2 in the header's extent: {density * size**2:.0f} per {size:g} m tile"
        tiles = count_text(summary.tiles, "tile")
        return f"{short} pts/m2: {summary.points_per_tile:.0f} points per {size:g} m tile (median of {tiles})"


def _units(place: Georeference) -> str:
    units = unit_name(place.metres_per_unit)
    if place.assumed:
        units = f"assumed {units}, as no CRS states them; if they are feet: --set xy_unit=ft (or us-ft)"
    if place.metres_per_unit_z != place.metres_per_unit:
        units += f", heights in {unit_name(place.metres_per_unit_z)}"
    return units


def _map_options(config: MapConfig, place: Georeference | None) -> Iterator[str]:
    """Yield the options that ``map`` needs too."""
    if config.crs is not None and place is not None:
        flat, own = horizontal_of(parse_crs(config.crs)), place.crs and horizontal_of(place.crs)
        if flat is not None and own is not None and same_crs(flat, own):
            yield from ("--crs", config.crs)
    classes = ",".join(map(str, config.ground_classes))
    options = [
        ("--set", f"force_crs={config.force_crs}", config.force_crs is not None),
        ("--xy-unit", config.xy_unit, config.xy_unit is not None),
        ("--z-unit", config.z_unit, config.z_unit is not None),
        ("--photo", config.photo, config.photo is not None),
        ("--set", "trust_points=true", config.trust_points),
        ("--ground", config.ground, config.ground != "auto"),
        ("--ground-classes", classes, config.ground_classes != GROUND_CLASSES),
    ]
    yield from (word for option, value, given in options if given for word in (option, str(value)))
    yield from ["--dtm"] * config.dtm


_CLASS_NAMES = (
    *("never classified", "unassigned", "ground", "low plants", "medium plants", "high plants", "building", "noise"),
    *("key point", "water", "rail", "road surface", "overlap", "wire guard", "wire", "tower", "wire connector"),
    *("bridge deck", "high noise"),
)
"""Of LAS classes 0 to 18."""


_CLASSIFIED = 2
"""Lower LAS classes are those of points that are not classified."""
_MANY_UNSEEN = 0.1
"""Share of tiles with too little seen from which on `info` names it."""
_LOW_M, _MANY = 0.3, 0.01
"""Median height above the ground, m, up to which points lie on it, and the share of tiles from which that is said."""


def _classified(file: FileReport, ground_classes: tuple[int, ...]) -> Iterator[tuple[str, str]]:
    """Yield whether points have classes; of a classified survey each class, and what `map` takes its points for."""
    if not file.has_ground or file.summary is None or file.info is None:
        none = file.info is not None and file.info.has_classes is False
        why = "the file has no classes" if none else "no point has a ground class"
        yield "classified", f"no: {why}; all points will be measured, so objects on the ground are relief"
        return
    yield "classified", f"yes: {file.summary.ground_share:.0%} of the points are ground"
    missed = []
    for code, (points, tiles, height) in file.summary.classes.items():
        name = file.info.class_names.get(code, "".join(_CLASS_NAMES[code : code + 1]))
        taken = "ground" if code in ground_classes else "obstacle" if code == 6 else "by height"
        above = "" if math.isnan(height) else f", {height:.2f} m above the ground (median)"
        share = f"{points / file.summary.points:.1%} of the points, in {tiles:.0%} of the tiles{above}"
        yield f"class {code}", f"{f'{name}: ' if name else ''}{share}; {taken}"
        apart = code < _CLASSIFIED and file.summary.never_classified > 0
        if taken == "by height" and abs(height) <= _LOW_M and tiles >= _MANY and not apart:
            missed.append(code)
    if any(code != 6 and code not in ground_classes for code in file.summary.classes):
        yield "by height", "obstacle or canopy, and if no ground is seen beneath, obstacle"
    if missed:
        codes, listed = (",".join(map(str, sorted(each))) for each in (missed, {*ground_classes, *missed}))
        text = f"points of class {codes} lie on the ground. If they are ground (roads, tracks), map them as such with"
        yield "left out", f"{text} --ground-classes {listed}"


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
