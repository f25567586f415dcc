"""Made-up stretches of drives over a map whose C_r is off by known numbers."""

import numpy as np

from bumpymap.core import DrivenStretches

STRETCH_M = 10.0


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
    return DrivenStretches(
        drive=np.arange(n) * options.get("drives", 1) // n,
        start_s=along / speed,
        end_s=(along + STRETCH_M) / speed,
        easting=500_000.0 + along,
        northing=np.full(n, 4_000_000.0),
        way_m=np.full(n, STRETCH_M),
        speed_mps=np.full(n, speed),
        measured=measured,
        measured_sd=sd * measured,
        c_r=c_r,
        c_r_low=c_r * np.exp(-1.2816 * map_sd),
        c_r_high=c_r * np.exp(1.2816 * map_sd),
        place_sd=np.zeros(n),
        class_id=np.digitize(c_r, calibration.class_limits).astype(np.uint8),
        measured_class=np.digitize(measured, calibration.class_limits).astype(np.uint8),
    )
