"""Job: compare a map with real drives over it, or measure drives alone.

Read a drive, put its positions on the map, measure, cut into stretches, read the map along them, compare, write.
"""

import logging
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias, TypedDict, TypeVar, Unpack

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from bumpymap.check.measure import COUNTS, LEFT_OUT, DriveMeasure, measure_drive
from bumpymap.check.places import MetrePlaces, are_inside, places_alone, places_on_map, read_slopes, window_around
from bumpymap.check.stretches import cut_stretches, read_along, read_line, with_ground
from bumpymap.core import (
    LEAST_WINDOW_M,
    NO_CLASS,
    BadInputError,
    CheckConfig,
    CheckedDrive,
    CheckedMap,
    CheckResult,
    DriveLog,
    DrivenStretches,
    Floats,
    MapAgreement,
    Progress,
    SilentProgress,
    TileField,
    UsageError,
    counted,
    path_of_call,
    refuse_unknown,
    settings_of_call,
    short_repr,
)
from bumpymap.layers import (
    CHECK_FILES,
    MANIFEST_NAME,
    MapOffset,
    MapReader,
    check_entries,
    class_limits,
    describe_file,
    open_map,
    place_entries,
    place_stretches,
    software_versions,
    write_stretches,
)
from bumpymap.readers import close_log_reader, drive_files, read_drive
from bumpymap.route import LineVehicle, line_vehicle
from bumpymap.views import check_layers, view_writers, write_check_page

_LEAST_STRETCHES = 5
"""Fewest stretches of a rank correlation (chosen)."""


def spearman(first: Floats, second: Floats) -> float:
    """Return the rank correlation of two series; NaN where one is constant, or with fewer than five values."""
    if len(first) < _LEAST_STRETCHES or not (np.ptp(first) and np.ptp(second)):
        return float("nan")
    return float(np.corrcoef(rankdata(first), rankdata(second))[0, 1])


def agreement_of(stretches: DrivenStretches, chosen: NDArray[np.bool_] | None = None) -> MapAgreement:
    """Return how well map and drives agree over stretches that are on the map.

    ``inside`` counts a stretch whose difference errors explain, as `MapOffset` tells.

    ``chosen`` (n,): stretches to look at; None: all on the map.
    """
    offset = MapOffset.of(stretches)
    on = np.isfinite(offset.ratio) & (True if chosen is None else chosen)
    if not on.any():
        return MapAgreement(0, 0.0, *[float("nan")] * 5)
    return MapAgreement(
        stretches=int(on.sum()),
        way_m=float(stretches.way_m[on].sum()),
        spearman=spearman(stretches.c_r[on], stretches.measured[on]),
        median_ratio=float(np.median(offset.ratio[on])),
        median_error=float(np.median(np.abs(offset.ratio[on] - 1.0))),
        inside=float((~offset.is_off[on]).mean()),
        same_class=float((stretches.class_id[on] == stretches.measured_class[on]).mean()),
    )


_OTHER_SPEED, _OTHER_VEHICLE = 0.2, 1.5
"""Difference of speed, as a share of the map's, and factor of C_r in the median, from which a warning is given
(chosen): the map was made for another speed, for another vehicle, or of other ground."""
_LITTLE_WAY_M = 50.0
"""Way that is too short to judge a map by, m (chosen)."""
_BLURRED_M = 1.5
"""Error of positions that blurs readings of single tiles, m: half a usual tile."""
_SHORT = LEFT_OUT.index("too short between the parts left out")


def left_out(drive: DriveMeasure, label: NDArray[np.int64]) -> dict[str, float]:
    """Return the length that does not count by reason, m; without reasons that take nothing."""
    way = np.abs(drive.speed) / drive.hertz
    reason = np.where((drive.reason == COUNTS) & (label < 0), _SHORT, drive.reason)
    length = np.bincount(reason, way, minlength=len(LEFT_OUT))
    return {name: float(metres) for name, metres in zip(LEFT_OUT, length, strict=True) if name and metres > 0.05}


def drive_warnings(drive: DriveMeasure, cut: DrivenStretches, *, has_positions: bool) -> list[str]:
    """Return what makes the readings of a drive less sure."""
    found = []
    floor = drive.floor / np.maximum(cut.speed_mps, 1e-9)
    share = float(np.median(floor / np.maximum(np.hypot(cut.measured, floor), 1e-9)))
    if np.isnan(drive.floor_radps):
        found.append(
            f"{drive.name}: the vehicle never stands still, so what sensor and engine alone read is not known and not "
            "taken off; C_r of smooth ground may read high. Let it stand for 10 s with its engine on before the drive"
        )
    elif share > 0.5:
        found.append(
            f"{drive.name}: sensor and engine alone read {share:.0%} of what was recorded on the way, so C_r is unsure"
        )
    if has_positions and np.isnan(drive.clock_offset_s):
        found.append(
            f"{drive.name}: the offset of the clocks of IMU and positions cannot be determined; "
            f"{drive.track.offset_s:+.2f} s is used. Turns, starts and stops on the way determine it"
        )
    if has_positions and drive.track.scatter.total_m > _BLURRED_M:
        found.append(
            f"{drive.name}: positions are off by {drive.track.scatter.total_m:.1f} m, about as much as a tile is wide, "
            "so readings of single tiles are blurred"
        )
    if cut.way_m.sum() < _LITTLE_WAY_M:
        found.append(f"{drive.name}: only {cut.way_m.sum():.0f} m count, too little to judge a map by")
    return found


def map_warnings(ground: CheckedMap, speeds: list[tuple[str, float]], agreement: MapAgreement) -> list[str]:
    """Return where drives and the vehicle profile of a map do not fit.

    ``speeds`` (str, float): name and median speed of each drive, m/s.
    """
    found = [
        f"{name} was driven at {speed:.2f} m/s and the map is made for {ground.speed_mps:g} m/s; C_r "
        f"changes with speed. Drive at {ground.speed_mps:g} m/s, or map the survey with `speed={speed:.2g}`"
        for name, speed in speeds
        if abs(speed / ground.speed_mps - 1.0) > _OTHER_SPEED
    ]
    ratio = agreement.median_ratio
    if agreement.stretches and not 1.0 / _OTHER_VEHICLE < ratio < _OTHER_VEHICLE:
        found.append(
            f"the map reads {ratio:.2g} times what was measured. Was the vehicle a {ground.vehicle}, as the map "
            "assumes, and has the ground stayed as it was surveyed?"
        )
    return found


PathLike: TypeAlias = str | os.PathLike[str]


class CheckSettings(TypedDict, total=False):
    """Settings of `check_drives`: fields of ``CheckConfig``."""

    columns: Mapping[str, str] | None
    band_hz: float
    window_m: float
    calibration: PathLike | None
    overwrite: bool


def check_drives(
    layers: PathLike | None,
    drives: PathLike | Iterable[PathLike],
    out: PathLike | None = None,
    **settings: Unpack[CheckSettings],
) -> CheckResult:
    """Compare a map with real drives over it, as ``bumpymap check`` does.

    Parameters
    ----------
    layers : path, Layers or None
        What `map_survey` or ``bumpymap map`` wrote; None measures the drives alone.
    drives : path, or several
        Each a log (CSV, a bag of ROS, ULog), or the files of one drive joined by commas.
    out : path, optional
        Folder for the page, the record and GIS layers; without it nothing is written.
    columns : mapping, optional
        Quantity -> column or topic that holds it, such as ``{"rate_y": "GyrY[deg/s]"}``; by default
        they are known by their names.
    band_hz : float
        Rates are low-passed at this frequency, Hz; default 10.
    window_m : float
        Length of a stretch, at least 5 m; default 10.
    calibration : path, optional
        The calibration that the map was made with, if it is not an included one.
    overwrite : bool
        Replace the files of an earlier check.

    Returns
    -------
    CheckResult
        ``agreement`` and ``by_class`` say how well they agree, ``drives`` what was found of each drive and its
        sensors, ``stretches`` holds what was measured [rad/m] beside what the map says. ``skipped`` names
        the drives that could not be used, with the reason; it is logged as a warning too.

    Raises
    ------
    BadInputError
        The layers cannot be read, or no drive can be used.
    UsageError
        A setting is wrong.
    OutputError
        The files cannot be written.

    Examples
    --------
    >>> import bumpymap
    >>> result = bumpymap.check_drives("site_layers", "drive.csv")
    >>> result.agreement.stretches == len(result.stretches.measured)
    True
    """
    refuse_unknown(settings, CheckSettings.__annotations__, "check_drives")
    columns = settings.pop("columns", None)
    if columns is not None and not (
        isinstance(columns, Mapping) and all(isinstance(text, str) for entry in columns.items() for text in entry)
    ):
        raise UsageError(f"columns is {short_repr(columns)}; give a dict, such as {{'rate_y': 'GyrY[deg/s]'}}")
    own = settings_of_call(settings, CheckConfig, "check_drives")
    each = [drives] if isinstance(drives, str | os.PathLike) else drives
    if not isinstance(each, Iterable):
        raise UsageError(f"drives is {short_repr(drives)}; give the log of a drive, or a list of logs")
    named = tuple(path_of_call("drives", drive) for drive in each)
    site = None if layers is None else Path(path_of_call("layers", layers))
    target = None if out is None else Path(path_of_call("out", out))
    return run_check(CheckConfig(named, site, target, columns, **own))[0]


Found = TypeVar("Found")

_log = logging.getLogger(__name__)

_MARGIN_M = 12.0
"""Margin of the map that is read around a drive, m (chosen): errors of positions reach no farther."""


@dataclass(frozen=True, slots=True)
class _Done:
    """One drive, measured and cut."""

    log: DriveLog
    drive: DriveMeasure
    label: NDArray[np.int64]
    """(samples,) number of the stretch of each, -1 where it belongs to none."""
    stretches: DrivenStretches
    of_line: DrivenStretches | None = None
    """The same, with what the map says of the driven line."""


def run_check(config: CheckConfig, progress: Progress | None = None) -> tuple[CheckResult, tuple[Path, ...]]:
    """Compare a map with drives as the settings ask, and write what was found; return it, and the files.

    Drives that cannot be used are left out; ``skipped`` of the result names them, and each is logged as a warning.
    Raises BadInputError: the layers cannot be read, or no drive can be used; UsageError, OutputError: the files cannot
    be written.
    """
    progress = progress or SilentProgress()
    site = None if config.layers is None else open_map(config.layers)
    _usable(((place, partial(drive_files, place)) for place in config.drives), {})
    if config.out is not None:
        CHECK_FILES.check(config.out, overwrite=config.overwrite)
    skipped: dict[str, str] = {}

    def read(place: str) -> tuple[DriveLog, MetrePlaces | None]:
        log = read_drive(place, config.columns)
        return log, places_alone(log) if site is None else places_on_map(log, site)

    progress.start("reading drives", len(config.drives))
    logs = _usable(((place, partial(read, place)) for place in counted(config.drives, progress)), skipped)
    close_log_reader()
    field = None if site is None else _field(site, [places for _, places in logs.values()])
    vehicle, why_not = (None, "") if site is None else line_vehicle(site, config.calibration, motion=False)
    progress.start("measuring drives", len(logs))
    left = counted(list(logs.items()), progress)
    done = _usable(((place, partial(_measured, *log, config, site, field, vehicle)) for place, log in left), skipped)
    for place, why in skipped.items():
        _log.warning("%s is left out: %s", place, why)
    result = _compared(list(done.values()), site)
    if why_not:
        alone = f"the drives are compared with the tiles alone, not with the ride of their own lines: {why_not}"
        result = replace(result, warnings=(*result.warnings, alone))
    result = replace(result, skipped=skipped)
    files: list[Path] = []
    if config.out is not None:
        progress.start("writing the check", None)
        manifest = {"settings": asdict(config)}
        files = write_check(result, config.out, ground=site, manifest=manifest, overwrite=config.overwrite)
    return result, tuple(files)


def _usable(steps: Iterable[tuple[str, Callable[[], Found]]], skipped: dict[str, str]) -> dict[str, Found]:
    """Return what a step found for each drive, by the drive as it was given; add those that it refuses to ``skipped``.

    Raises BadInputError: no drive is left.
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
            f"none of the {len(skipped)} drives can be used:", *(f"  {place}: {why}" for place, why in skipped.items())
        ) from error
    return found


def _field(site: MapReader, placed: list[MetrePlaces | None]) -> TileField:
    parts = [_on_map(places, site) for places in placed if places is not None]
    easting, northing = (np.concatenate([part[axis] for part in parts]) for axis in (0, 1))
    return site.read(window_around(site, easting, northing, _MARGIN_M), ("c_r", "c_r_low", "c_r_high"))


def _measured(
    log: DriveLog,
    places: MetrePlaces | None,
    config: CheckConfig,
    site: MapReader | None,
    field: TileField | None,
    vehicle: LineVehicle | None = None,
) -> _Done:
    slope_at = None
    if site is not None and places is not None:
        slope_at = read_slopes(site, window_around(site, *_on_map(places, site), _MARGIN_M))
    drive = measure_drive(log, places, config.band_hz, slope_at)
    if field is not None:
        drive = with_ground(drive, field)
    label, cut = cut_stretches(drive, config.window_m)
    if not len(cut.start_s):
        lost = ", ".join(f"{name} {metres:.0f} m" for name, metres in left_out(drive, label).items())
        length = float((np.abs(drive.speed) / drive.hertz).sum())
        raise BadInputError(
            f"{drive.name}: no stretch of {LEAST_WINDOW_M:g} m or more is left of {length:.0f} m of way: {lost}. "
            "Drive straight on for at least 10 m at a time, over ground that the map knows"
        )
    if site is None or field is None:
        return _Done(log, drive, label, cut)
    of_line = None if vehicle is None else read_line(drive, label, cut, site, vehicle)
    return _Done(log, drive, label, read_along(drive, label, cut, field), of_line)


def _on_map(places: MetrePlaces, site: MapReader) -> tuple[Floats, Floats]:
    """Return the positions in the extent of the map: others may lie anywhere."""
    inside = places.place[are_inside(places, site)]
    return inside.real, inside.imag


def _compared(done: list[_Done], site: MapReader | None) -> CheckResult:
    ground = None
    if site is not None:
        first, second, third = class_limits(site.manifest)
        about = site.vehicle.name, site.calibration_id, site.vehicle.speed_mps
        ground = CheckedMap(site.manifest["survey"]["name"], site.folder, *about, (first, second, third))
    stretches = _joined([one.stretches for one in done], ground)
    drives = tuple(_checked(one) for one in done)
    if ground is None:
        return CheckResult(None, drives, stretches, None, {}, ())
    agreement = agreement_of(stretches)
    if not agreement.stretches:
        raise BadInputError(
            f"no stretch of the drives lies on ground that {ground.folder} knows. Give the layers of the driven ground"
        )
    on = np.isfinite(stretches.c_r) & (stretches.measured > 0.0)
    classes = map(int, np.unique(stretches.class_id[on]))
    by_class = {number: agreement_of(stretches, stretches.class_id == number) for number in classes}
    speeds = [(drive.name, drive.speed_mps) for drive in drives]
    of_line = [one.of_line for one in done if one.of_line is not None]
    by_line = _joined(of_line, ground) if len(of_line) == len(done) else None
    of_lines = None if by_line is None else agreement_of(by_line)
    return CheckResult(
        ground=ground,
        drives=drives,
        stretches=stretches,
        agreement=agreement,
        by_class=by_class,
        warnings=tuple(map_warnings(ground, speeds, of_lines or agreement)),
        by_line=by_line,
        agreement_by_line=of_lines,
    )


def _joined(parts: list[DrivenStretches], ground: CheckedMap | None) -> DrivenStretches:
    """Return the stretches of all drives, in order, with their classes; without a map they lie nowhere."""
    columns = {each.name: np.concatenate([getattr(one, each.name) for one in parts]) for each in fields(parts[0])}
    columns["drive"] = np.repeat(np.arange(len(parts)), [len(one.way_m) for one in parts])
    if ground is None:
        columns["easting"] = columns["northing"] = np.full_like(columns["easting"], np.nan)
    else:
        for name, values in (("class_id", columns["c_r"]), ("measured_class", columns["measured"])):
            found = np.where(np.isfinite(values), np.digitize(values, ground.class_limits), NO_CLASS)
            columns[name] = found.astype(np.uint8)
    return DrivenStretches(**columns)


def _checked(one: _Done) -> CheckedDrive:
    drive, cut, log = one.drive, one.stretches, one.log
    same = ("band_hz", "clock_offset_s", "clock_offset_sd_s", "clock_drift_ppm", "mount_deg", "floor_radps")
    lost = left_out(drive, one.label)
    used = float(cut.way_m.sum())
    counts = (drive.reason == COUNTS) & (one.label >= 0)
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
        **{name: getattr(drive, name) for name in same},
        position_error_m=drive.track.scatter.total_m if has_positions else float("nan"),
        columns=log.columns,
        notes=(*log.notes, *drive.notes),
        warnings=tuple(drive_warnings(drive, cut, has_positions=has_positions)),
    )


def write_check(
    result: CheckResult,
    out: Path,
    *,
    ground: MapReader | None = None,
    manifest: Mapping[str, Any] | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write what drives show of a map to a folder, which is created if it is missing.

    All files appear or none; links are replaced, never followed. Files of an earlier check that this one does not write
    are removed: without positions on a map there is nothing for GIS. Except for check.json no file depends on the time
    or on folder names. ``result``: with at least one drive; ``ground``: the map, None without one; ``manifest``: the
    run's own entries for check.json, such as settings. Returns what was written. Raises UsageError, OutputError: see
    `OutputFolder.check`, or a file cannot be written; BadInputError: the layers cannot be read, or positions have no
    longitude and latitude.
    """
    CHECK_FILES.check(out, overwrite=overwrite)
    placement = None if ground is None else place_stretches(result.stretches, ground)
    checked: dict[str, Any] = {}
    if ground is not None:
        layers = {"path": str(ground.folder), "run_sha256": describe_file(ground.folder / MANIFEST_NAME)["sha256"]}
        checked = {"layers": [layers], **{name: ground.manifest[name] for name in ("vehicle", "calibration")}}
        checked |= {} if placement is None else place_entries(placement)

    head = {"format": "bumpymap-check", "version": 1, **(manifest or {}), "versions": software_versions(), **checked}
    found = check_entries(result)
    writers: dict[str, Callable[[Path], None]] = {
        "check.html": partial(write_check_page, result, ground if placement is not None else None)
    }
    if ground is not None and placement is not None:
        writers["check.geojson"] = partial(write_stretches, result, placement)
        writers |= view_writers(check_layers(), placement, ground, out, "the map against real drives")
    return CHECK_FILES.write(out, writers, lambda _, files: {**head, "files": files, **found}, overwrite=overwrite)
