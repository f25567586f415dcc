"""Drive along planned ways over the layers of a map, and compare with what the map says of them.

    python tests/benchmarks/route_drives.py LAYERS --out FOLDER [--pairs 20] [--repeats 4] [--calibration FILE]

Starts and goals are drawn on passable ground, 40 to 150 m apart. The vehicle of the layers is driven along the best
way and along the straight line between them, over the heights of the map and with its obstacles as walls. The drives
are kept in FOLDER, and the same command goes on with them; ``routes.json`` holds all figures.
"""

import argparse
import json
import os
from dataclasses import asdict
from pathlib import Path

from _records import show_records
from _route_trial import RoutePlanner, RouteTrialSettings, evaluate_routes

from bumpymap.core import SilentProgress
from bumpymap.lab.evaluate.report import plain_record
from bumpymap.lab.evaluate.survey_trial import TrialOptions
from bumpymap.layers import open_map
from bumpymap.rating import find_calibration


def main() -> None:
    """Plan, drive, compare and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("layers", nargs="+", type=Path, help="layers of a map, or of its sheets")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=4)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--calibration", type=Path)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    site = open_map(given.layers)
    calibration = find_calibration(site.vehicle.name, given.calibration)
    settings = RouteTrialSettings(given.pairs, given.repeats, given.seed)
    options = TrialOptions(given.out, given.jobs, overwrite=False, progress=SilentProgress())
    found = evaluate_routes(site, calibration, RoutePlanner.of(site), settings, options)
    for name, own in found.agreement.items():
        show_records(f"C_r, {name}", [own])
        show_records(f"Arrivals, {name}", [found.arrivals[name]])
    show_records("Best way against straight line", [found.order])
    show_records("By class of ground", found.ground)
    record = json.dumps(plain_record(asdict(found)), indent=1, allow_nan=False)
    (given.out / "routes.json").write_text(record + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
