"""Draw docs/pages/img/library_c_r.png: what each terrain of the library costs each shipped vehicle."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bumpymap.lab.simulate.drive import library_terrains
from bumpymap.lab.terrains import KINDS
from bumpymap.rating.calibration import Calibration, shipped_calibrations

OUT = Path(__file__).parents[1] / "pages" / "img" / "library_c_r.png"


def draw_vehicle(axis: Axes, calibration: Calibration) -> None:
    """One dot a terrain, in the column of its kind; grey lines are the class limits."""
    driven = library_terrains(calibration)
    known = [t for t in driven if t.c_r is not None]
    within = np.array([t.index for t in known]) / max(t.index for t in driven) - 0.5
    place = np.array([KINDS.index(t.kind) for t in known]) + 0.6 * within
    fails = [t.failed / t.drives for t in known]
    dots = axis.scatter(place, [t.c_r for t in known], c=fails, s=9, cmap="viridis_r", vmin=0, vmax=1)
    for limit in calibration.class_limits:
        axis.axhline(limit, color="0.5", linewidth=0.8, linestyle="--")
    axis.set(yscale="log", ylim=(0.003, 2.5), xlim=(-0.6, len(KINDS) - 0.4), ylabel="C_r [rad/m]")
    lost = len(driven) - len(known)
    axis.set_title(f"{calibration.vehicle['name']}: no drive came through on {lost} of {len(driven)}", loc="left")
    axis.figure.colorbar(dots, ax=axis, label="failed drives", pad=0.01)


def main() -> None:
    """Write the picture."""
    names = shipped_calibrations()[::-1]
    figure = Figure(figsize=(9, 1.0 + 2.5 * len(names)), dpi=85, layout="constrained")
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for axis, name in zip(axes, names, strict=True):
        draw_vehicle(axis, Calibration.shipped(name))
    axes[-1].set_xticks(range(len(KINDS)), KINDS, rotation=60, ha="right")
    figure.savefig(OUT, metadata={"Software": None})


if __name__ == "__main__":
    main()
