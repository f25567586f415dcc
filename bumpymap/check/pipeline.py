"""Job: hold a map against real drives over it, or measure drives alone.

Read a drive, put its positions on the map, measure, cut into stretches, read the map along them, compare, write.
"""

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from bumpymap.check.agreement import agreement_by_class, agreement_of
from bumpymap.check.drive_measure import COUNTS, DriveMeasure, WayStretch
from bumpymap.check.ground import DriveSteps, MapReading, drive_steps, read_along, with_ground
from bumpymap.check.measure import measure_drive
from bumpymap.check.notes import drive_warnings, left_out, map_warnings, refuse_without_stretches
from bumpymap.check.place_on_map import places_alone, places_on_map
from bumpymap.check.places import MetrePlaces
from bumpymap.check.settings import CheckConfig, ReadingSettings
from bumpymap.check.slopes import SlopeMap, window_around
from bumpymap.check.stretches import cut_stretches
from bumpymap.check.tiles import TileDrive, driven_tiles
from bumpymap.core import (
    NO_CLASS,
    BadInputError,
    CheckedDrive,
    CheckedMap,
    CheckResult,
    DriveLog,
    DrivenStretches,
    Progress,
    SilentProgress,
    TileField,
    counted,
)
from bumpymap.layers import RouteMap, check_check_out, open_map, write_check
from bumpymap.readers import close_log_reader, read_drive

__all__ = ["CheckRun", "run_check"]

Floats = NDArray[np.float64]
Found = TypeVar("Found")

_MARGIN_M = 12.0
"""Of the map that is read around a drive: errors of positions reach so far."""


@dataclass(frozen=True, slots=True)
class CheckRun:
    """What a check found, and what it wrote."""

    result: CheckResult
    files: tuple[Path, ...]


@dataclass(frozen=True, slots=True)
class _Done:
    """One drive, measured and cut."""

    log: DriveLog
    drive: DriveMeasure
    cut: WayStretch
    steps: DriveSteps | None = None
    reading: MapReading | None = None


def run_check(config: CheckConfig, progress: Progress | None = None) -> CheckRun:
    """Hold a map against drives as the settings ask, and write what was found.

    Drives that cannot be used are left out; ``skipped`` of the result names them.

    Raises
    ------
    BadInputError
        The layers cannot be read, or no drive can be used.
    UsageError, OutputError
        The files cannot be written.
    """
    progress = progress or SilentProgress()
    if config.out is not None:
        check_check_out(config.out, overwrite=config.overwrite)
    site = None if config.layers is None else open_map([config.layers])
    skipped: dict[str, str] = {}

    def read(place: str) -> tuple[DriveLog, MetrePlaces | None]:
        log = read_drive(place, config.columns)
        return log, places_alone(log) if site is None else places_on_map(log, site)

    progress.start("reading drives", len(config.drives))
    logs = _usable(((place, partial(read, place)) for place in counted(config.drives, progress)), skipped)
    close_log_reader()
    field = None if site is None else _field(site, [places for _, places in logs.values()])
    progress.start("measuring drives", len(logs))
    left = counted(list(logs.items()), progress)
    settings = config.measuring
    done = _usable(((place, partial(_measured, *log, settings, site, field)) for place, log in left), skipped)
    result = replace(_compared(list(done.values()), site, field), skipped=skipped)
    files: list[Path] = []
    if config.out is not None:
        progress.start("writing the check", None)
        manifest = {"settings": asdict(config)}
        files = write_check(result, config.out, ground=site, manifest=manifest, overwrite=config.overwrite)
    return CheckRun(result, tuple(files))


def _usable(steps: Iterable[tuple[str, Callable[[], Found]]], skipped: dict[str, str]) -> dict[str, Found]:
    """Return what a step found for each drive, by the drive as it was given; add those that it refuses to ``skipped``.

    Raises
    ------
    BadInputError
        No drive is left.
    """
    found: dict[str, Found] = {}
    error: BadInputError | None = None
    for place, step in steps:
        try:
            found[place] = step()
        except BadInputError as refusal:
            error = refusal
            skipped[place] = str(refusal)
    if not found and error is not None:
        if len(skipped) == 1:
            raise error
        raise BadInputError(
            f"none of the {len(skipped)} drives can be used:",
            *(f"  {place}: {why}" for place, why in skipped.items()),
        ) from error
    return found


def _field(site: RouteMap, placed: list[MetrePlaces | None]) -> TileField:
    """Read the part of a map that was driven."""
    parts = [_on_map(places, site) for places in placed if places is not None]
    easting, northing = (np.concatenate([part[axis] for part in parts]) for axis in (0, 1))
    return site.read(window_around(site, easting, northing, _MARGIN_M), ("c_r", "c_r_low", "c_r_high"))


def _measured(
    log: DriveLog,
    places: MetrePlaces | None,
    settings: ReadingSettings,
    site: RouteMap | None,
    field: TileField | None,
) -> _Done:
    """Measure one drive, cut it, and read the map along it."""
    if site is None or field is None or places is None:
        drive = measure_drive(log, places, settings)
        cut = cut_stretches(drive, settings.window_m)
        refuse_without_stretches(drive, cut)
        return _Done(log, drive, cut)
    slopes = SlopeMap.of(site, window_around(site, *_on_map(places, site), _MARGIN_M))
    drive = with_ground(measure_drive(log, places, settings, slopes.slope_at), field)
    cut = cut_stretches(drive, settings.window_m)
    refuse_without_stretches(drive, cut)
    steps = drive_steps(drive, cut, field)
    return _Done(log, drive, cut, steps, read_along(steps, len(cut.start_s), field))


def _on_map(places: MetrePlaces, site: RouteMap) -> tuple[Floats, Floats]:
    """Return the positions in the extent of the map: others may lie anywhere."""
    size, window = site.grid.tile_size, site.window
    col, row = places.place.real / size - window.col, places.place.imag / size - window.row
    inside = (col >= 0) & (col < window.cols) & (row >= 0) & (row < window.rows)
    return places.place.real[inside], places.place.imag[inside]


def _compared(done: list[_Done], site: RouteMap | None, field: TileField | None) -> CheckResult:
    """Compare all drives with the map."""
    ground = None if site is None else _ground(site)
    limits = (np.inf,) * 3 if ground is None else ground.class_limits
    stretches = _stretches(done, limits)
    drives = tuple(_checked(one) for one in done)
    if field is None or ground is None:
        return CheckResult(None, drives, stretches, None, None, {}, ())
    agreement = agreement_of(stretches)
    if not agreement.stretches:
        raise BadInputError(
            f"no stretch of the drives lies on ground that {ground.folder} knows. Give the layers of the driven ground"
        )
    speeds = [(drive.name, drive.speed_mps) for drive in drives]
    return CheckResult(
        ground=ground,
        drives=drives,
        stretches=stretches,
        tiles=driven_tiles(_on_tiles(done), field, limits),
        agreement=agreement,
        by_class=agreement_by_class(stretches),
        warnings=tuple(map_warnings(ground, speeds, agreement)),
    )


def _ground(site: RouteMap) -> CheckedMap:
    manifest = site.manifests[0]
    survey = manifest.get("survey", {})
    limits = manifest.get("calibration", {}).get("class_limits", ())
    if len(limits) != 3:
        raise BadInputError(f"{site.folders[0]} does not state its class limits. Map the survey again")
    first, second, third = map(float, limits)
    return CheckedMap(
        name=str(survey.get("name", site.folders[0].name)),
        folder=site.folders[0],
        vehicle=site.vehicle.name,
        calibration_id=site.calibration_id,
        speed_mps=site.vehicle.speed_mps,
        class_limits=(first, second, third),
    )


def _stretches(done: list[_Done], limits: Iterable[float]) -> DrivenStretches:
    """Return the stretches of all drives, in order."""
    edges = list(limits)
    placed = any(one.reading is not None for one in done)
    cut = {
        name: np.concatenate([getattr(one.cut, name) for one in done])
        for name in ("start_s", "end_s", "way_m", "speed_mps", "measured", "measured_sd", "easting", "northing")
    }
    nothing = np.full_like(cut["measured"], np.nan)
    if not placed:
        cut |= {"easting": nothing, "northing": nothing}
    readings = [one.reading for one in done if one.reading is not None]
    read = {
        name: np.concatenate([getattr(reading, name) for reading in readings]) if placed else nothing
        for name in ("c_r", "low", "high", "place_sd")
    }
    return DrivenStretches(
        drive=np.repeat(np.arange(len(done)), [len(one.cut.start_s) for one in done]),
        **cut,
        c_r=read["c_r"],
        c_r_low=read["low"],
        c_r_high=read["high"],
        place_sd=read["place_sd"],
        class_id=_classes(read["c_r"], edges),
        measured_class=_classes(cut["measured"] if placed else nothing, edges),
    )


def _classes(values: Floats, edges: list[float]) -> NDArray[np.uint8]:
    return np.where(np.isfinite(values), np.digitize(values, edges), NO_CLASS).astype(np.uint8)


def _on_tiles(done: list[_Done]) -> list[TileDrive]:
    """Return each drive with its steps and the relative error of its lengths."""
    found = []
    for one in done:
        if one.steps is not None:
            cut = one.cut
            relative = float(np.median(one.drive.track.way_sd(cut.start_s, cut.end_s) / cut.way_m))
            found.append(TileDrive(one.drive, one.steps, relative))
    return found


def _checked(one: _Done) -> CheckedDrive:
    """Return what was found about a drive and its sensors."""
    drive, cut, log = one.drive, one.cut, one.log
    lost = left_out(drive, cut)
    used = float(cut.way_m.sum())
    counts = (drive.reason == COUNTS) & (cut.label >= 0)
    has_positions = log.places is not None
    return CheckedDrive(
        name=drive.name,
        paths=log.paths,
        seconds=float(drive.time[-1] - drive.time[0]),
        way_m=used + sum(lost.values()),
        used_m=used,
        left_out_m=lost,
        speed_mps=float(np.median(np.abs(drive.speed[counts]))),
        rate_hz=drive.hertz,
        band_hz=drive.band_hz,
        clock_offset_s=drive.clock_offset_s,
        clock_offset_sd_s=drive.clock_offset_sd_s,
        clock_drift_ppm=drive.clock_drift_ppm,
        mount_deg=drive.mount_deg,
        floor_radps=drive.floor_radps,
        position_error_m=drive.track.scatter.total_m if has_positions else float("nan"),
        columns=log.columns,
        notes=(*log.notes, *drive.notes),
        warnings=tuple(drive_warnings(drive, cut, has_positions=has_positions)),
    )
