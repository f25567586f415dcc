"""Print how far C_r depends on speed, time step and friction: the table in ride-cost.md. About two minutes."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.settings import DriveSettings, Physics
from bumpymap.lab.simulate.drive import drive
from bumpymap.lab.simulate.model import PatchGround
from bumpymap.lab.terrains import make_textures
from bumpymap.rating import Vehicle

PATCHES = 24
Z_RANGE_M = 0.3


def mean_c_r(profile: Vehicle, settings: DriveSettings, patches: NDArray[np.floating]) -> tuple[float, int]:
    """Mean C_r over patches, (n, pixels, pixels) m, and the number of completed drives."""
    drives = [
        drive(profile, PatchGround.from_heights(patch, 3.0), seed, settings) for seed, patch in enumerate(patches)
    ]
    c_r = [d.c_r for d in drives if d.outcome == "completed"]
    return float(np.mean(c_r)), len(c_r)


def main() -> None:
    """Change one setting at a time."""
    warthog, settings = Vehicle.load("warthog"), DriveSettings()
    rough = make_textures("high_noise", PATCHES, np.random.default_rng(1)).astype(np.float64) * Z_RANGE_M
    cases = [(f"speed {v:g} m/s", replace(warthog, speed_mps=v), settings) for v in (0.5, 1.0, 2.0, 3.0)]
    cases += [
        (f"time step {1000 * dt:g} ms", warthog, replace(settings, physics=Physics(time_step=dt)))
        for dt in (0.0005, 0.001, 0.005)
    ]
    cases += [(f"friction {mu:g}", warthog, replace(settings, physics=Physics(friction=mu))) for mu in (0.5, 0.7, 1.5)]
    for name, profile, chosen in cases:
        c_r, completed = mean_c_r(profile, chosen, rough)
        print(f"{name:18s} {c_r:.3f} rad/m  {completed} of {PATCHES} drives completed", flush=True)  # noqa: T201
    level = np.random.default_rng(1).normal(0.0, 0.01, (PATCHES, 15, 15))
    relief = float(np.mean(level.max(axis=(1, 2)) - level.min(axis=(1, 2))))
    print(f"level, 1 cm noise  {mean_c_r(warthog, settings, level)[0]:.3f} rad/m, relief {relief:.3f} m")  # noqa: T201


if __name__ == "__main__":
    main()
