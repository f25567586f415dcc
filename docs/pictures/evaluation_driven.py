"""Draw docs/pages/img/evaluation_driven.png: predicted and driven C_r, by report.json of tests/tools/driven.py.

``python docs/pictures/evaluation_driven.py report.json PICTURE.png``. Needs matplotlib.
"""

import json
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

COLOUR = {"ride": "#2a7f62", "table": "#c77c11"}
MOST_FAILED = 0.25

patches = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["patches"]
columns = {name: np.array(values, np.float64) for name, values in patches["driven"].items()}
good = columns["failed"] <= MOST_FAILED * (columns["failed"] + columns["completed"])
good &= columns["c_r"] > 0
driven = columns["c_r"][good]
figure = Figure(figsize=(5 * len(patches["verdicts"]), 4.4), layout="constrained")
panels = figure.subplots(1, len(patches["verdicts"]), squeeze=False)[0]
for axes, (name, verdict) in zip(panels, patches["verdicts"].items(), strict=True):
    c_r, low, high = (np.array(verdict[column], np.float64)[good] for column in ("c_r", "c_r_low", "c_r_high"))
    axes.errorbar(driven, c_r, [c_r - low, high - c_r], fmt="none", ecolor="0.8", elinewidth=0.7, zorder=1)
    axes.scatter(driven, c_r, s=10, color=COLOUR[name], zorder=2)
    ends = [min(driven.min(), c_r.min()) * 0.8, max(driven.max(), c_r.max()) * 1.25]
    axes.plot(ends, ends, color="0.4", linewidth=0.8)
    axes.set(xlim=ends, ylim=ends, xscale="log", yscale="log")
    for side in (axes.xaxis, axes.yaxis):  # plain numbers: 0.1, 0.2, 0.5, 1
        side.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        side.set_minor_locator(NullLocator())
    axes.set(xlabel="driven C_r [rad/m]", ylabel="predicted C_r [rad/m], 80 % interval")
    axes.set_title(f"{name}: {len(driven)} patches", loc="left")
figure.savefig(sys.argv[2], dpi=110, metadata={"Software": None})
