"""Draw docs/pages/img/calibration_warthog.png: what the shipped calibration holds. Needs matplotlib."""

from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt

from bumpymap.core.types import CLASS_NAMES
from bumpymap.rating.calibration import Calibration

OUT = Path(__file__).parents[1] / "pages" / "img" / "calibration_warthog.png"
COLOURS = ("#2a7f62", "#3b73b9", "#c77c11", "#b03a48")


def main() -> None:
    """Write the picture."""
    calibration = Calibration.shipped("warthog")
    z_range = np.array(calibration.z_range)
    figure, (upper, lower) = plt.subplots(
        2, 1, figsize=(7.5, 7), sharex=True, height_ratios=(3, 1), layout="constrained"
    )
    for texture, colour, line, deviations, failed in zip(
        calibration.textures, COLOURS, calibration.c_r, calibration.c_r_log_sd, calibration.p_fail, strict=True
    ):
        c_r = np.array(line, dtype=float)
        spread = np.exp(np.array(deviations, dtype=float))
        upper.fill_between(z_range, c_r / spread, c_r * spread, color=colour, alpha=0.15, linewidth=0)
        upper.plot(z_range, c_r, "o-", color=colour, markersize=4, label=texture)
        lower.plot(z_range, failed, "o-", color=colour, markersize=4)
    edges = [4e-3, *calibration.class_limits, 2.5]
    for class_id, name in enumerate(CLASS_NAMES):
        middle = np.sqrt(edges[class_id] * edges[class_id + 1])
        upper.text(1.01, middle, f"{class_id} {name}", transform=upper.get_yaxis_transform(), va="center", color="0.35")
    for limit in calibration.class_limits:
        upper.axhline(limit, color="0.5", linewidth=0.8, linestyle="--")
    upper.set(xscale="log", yscale="log", ylim=(edges[0], edges[-1]), ylabel="C_r [rad/m]")
    upper.legend(loc="upper left", frameon=False)
    upper.set_title("What each ground costs a Warthog at 1 m/s", loc="left")
    lower.set(
        xlabel="z range of the plane-removed patch [m]", ylabel="failed drives", ylim=(-0.03, 1.03), xlim=(0.018, 3.1)
    )
    ticks = [0.02, 0.05, 0.1, 0.2, 0.5, 1, 2]
    lower.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    lower.minorticks_off()
    figure.savefig(OUT, dpi=110)


if __name__ == "__main__":
    main()
