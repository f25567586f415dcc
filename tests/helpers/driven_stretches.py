"""Made-up stretches of drives over a map whose C_r is off by known numbers."""

from dataclasses import replace

import numpy as np
from check_records import STRETCH_M, stretches_at


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
