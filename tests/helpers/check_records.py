"""Made-up findings of drives over a map, and stretches over one whose C_r is off by known numbers."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from bumpymap.check.pipeline import agreement_of
from bumpymap.core import NO_CLASS, CheckedDrive, CheckedMap, CheckResult, DrivenStretches
from bumpymap.layers import open_map

LIMITS = (0.05, 0.13, 0.3)
STRETCH_M = 10.0


def make_drive(name="drive 1", **changes):
    """Findings of a good drive; ``changes`` replace some."""
    drive = CheckedDrive(
        name=name,
        paths=(Path("logs") / f"{name}.mcap",),
        seconds=412.5,
        way_m=640.2,
        used_m=300.0,
        left_out_m={"turning": 120.4, "standing": 0.0, "no position": 88.8},
        speed_mps=1.96,
        rate_hz=200.0,
        band_hz=10.0,
        clock_offset_s=-0.213,
        clock_offset_sd_s=0.004,
        clock_drift_ppm=18.0,
        mount_deg=(1.25, -4.5, 2.75),
        floor_radps=0.0041,
        position_error_m=0.03,
        columns={"rate_y": "gyro_y [deg/s]"},
        notes=("times are Unix seconds",),
        warnings=(),
    )
    return replace(drive, **changes)


def stretches_at(points, c_r, factor, *, drives=1, sd=0.05, unknown=(), speed=2.0, limits=LIMITS):
    """Stretches with ``points`` in their middle; the drive felt ``c_r * factor``; those ``unknown`` are off the map."""
    n = len(points)
    c_r = np.array(c_r, np.float64)
    measured = c_r * factor
    c_r[list(unknown)] = np.nan
    start = np.arange(n) * STRETCH_M / speed
    classes = np.digitize(measured, limits).astype(np.uint8)
    by_map = np.where(np.isfinite(c_r), np.digitize(c_r, limits), NO_CLASS).astype(np.uint8)
    return DrivenStretches(
        drive=np.minimum(np.arange(n) * drives // n, drives - 1),
        start_s=start,
        end_s=start + STRETCH_M / speed,
        easting=np.array(points[:, 0]),
        northing=np.array(points[:, 1]),
        way_m=np.full(n, STRETCH_M),
        speed_mps=np.full(n, speed),
        measured=measured,
        measured_sd=sd * measured,
        c_r=c_r,
        c_r_low=c_r * 0.8,
        c_r_high=c_r * 1.25,
        place_sd=0.02 * c_r,
        class_id=by_map,
        measured_class=classes,
    )


def make_check(stretches, *, drives=1, warnings=(), ground=True):
    """Everything that a check finds."""
    by_line = replace(stretches, c_r=np.where(np.isfinite(stretches.c_r), stretches.measured, np.nan))
    codes = [int(code) for code in np.unique(stretches.class_id) if code != NO_CLASS]
    return CheckResult(
        ground=CheckedMap("site", Path("layers"), "warthog", "c0ffee", 2.0, LIMITS) if ground else None,
        drives=tuple(make_drive(f"drive {number + 1}") for number in range(drives)),
        stretches=stretches,
        agreement=agreement_of(stretches) if ground else None,
        by_class={code: agreement_of(stretches, stretches.class_id == code) for code in codes} if ground else {},
        warnings=tuple(warnings),
        by_line=by_line if ground else None,
        agreement_by_line=agreement_of(by_line) if ground else None,
    )


def made_up_check(n=40, *, bias=1.0, noise=0.1, seed=5, drives=1, **options):
    """Findings along a way near the corners of `route_records`; the drive felt ``bias`` times what the map says."""
    rng = np.random.default_rng(seed)
    along = np.linspace(0.0, 1.0, n)
    points = np.column_stack([330_010.0 + 240.0 * along, 2_040_030.0 + 50.0 * np.sin(3.0 * along)])
    c_r = 0.03 * np.exp(2.6 * along)
    factor = bias * np.exp(noise * rng.standard_normal(n))
    unknown = options.pop("unknown", ())
    return make_check(stretches_at(points, c_r, factor, drives=drives, unknown=unknown), drives=drives, **options)


def on_site(result, site):
    """Lay the stretches of a check over the layers in a folder; gives the check and the map."""
    ground, n = open_map(site), len(result.stretches.drive)
    bounds, part = ground.grid.window_bounds(ground.window), np.linspace(0.1, 0.9, n)
    easting = bounds.west + part * (bounds.east - bounds.west)
    northing = bounds.south + part * (bounds.north - bounds.south)
    return replace(result, stretches=replace(result.stretches, easting=easting, northing=northing)), ground


def driven_stretches(calibration, n=50, *, shift=0.3, tilt=0.0, seed=0, **options):
    """Drives along a line, ``n`` stretches; the map's error is ``map_sd`` (half of it common to 30 m)."""
    rng = np.random.default_rng(seed)
    middle = np.log(calibration.class_limits[1])
    log_c_r = middle - 0.5 + np.repeat(rng.normal(0, 0.6, n // 5 + 1), 5)[:n] + rng.normal(0, 0.2, n)
    map_sd, sd = options.get("map_sd", 0.1), options.get("sd", 0.05)
    error = map_sd * np.sqrt(0.5) * (np.repeat(rng.normal(size=n // 3 + 1), 3)[:n] + rng.normal(size=n))
    error += sd * rng.normal(size=n)
    measured = np.exp(middle + shift + (1 + tilt) * (log_c_r - middle) + error)
    c_r, along = np.exp(log_c_r), STRETCH_M * np.arange(n)
    speed = options.get("speed", calibration.vehicle["speed_mps"])
    made = stretches_at(
        np.column_stack([500_000.0 + along, np.full(n, 4_000_000.0)]), c_r, measured / c_r, sd=sd, speed=speed,
        drives=options.get("drives", 1), limits=calibration.class_limits,
    )  # fmt: skip
    low, high = (c_r * np.exp(edge * map_sd) for edge in (-1.2816, 1.2816))
    return replace(made, measured=measured, c_r_low=low, c_r_high=high, place_sd=np.zeros(n))
