"""Make sample_data/quarry_drive_imu.csv and quarry_drive_gnss.csv: a simulated drive over the sample site.

    python docs/pictures/sample_drive.py FOLDER

A Warthog is driven in DART over the map of `make demo`, and its sensors are simulated; no vehicle was driven. The
motion is kept in FOLDER. Needs the extra ``sim``.
"""

import sys
from dataclasses import replace
from pathlib import Path

import bumpymap

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "worlds"))

from check import ROOT, SENSORS, drive
from driven_ways import Stop
from sensed_drives import read_motion, sense_drive, write_drive_files

WAY = ((14, 10), (14, 29), (62, 29))
"""Metres east and north of the south-west corner of the map: road, washboard."""
SLOW_SENSORS = replace(SENSORS, imu_hz=50.0, cutoff_hz=20.0, gnss_hz=5.0)
DECIMALS = {"imu": (2, *[3] * 3, 2, 2, 1), "gnss": (2, 8, 8, 3)}
"""Of the columns: as few as the sensors are good for, so that the files are small."""


def main(folder: Path) -> None:
    """Map, drive and record; what is there already is used again."""
    folder.mkdir(parents=True, exist_ok=True)
    layers, motion = folder / "layers", folder / "motion.npz"
    if not (layers / "run.json").exists():
        bumpymap.map_survey(ROOT / "sample_data" / "quarry.laz", layers)
    if not motion.exists():
        drive(layers, motion, WAY, (Stop(30.0, 3.0),))
    log = sense_drive(read_motion(motion), SLOW_SENSORS, 1, "quarry_drive", "EPSG:32632")
    start = log.imu.time[0]
    log = replace(log, imu=replace(log.imu, time=log.imu.time - start))
    log = replace(log, places=replace(log.places, time=log.places.time - start))
    for path in write_drive_files(log, folder):
        head, *rows = path.read_text().splitlines()
        decimals = DECIMALS[path.stem.rpartition("_")[2]]
        short = [",".join(f"{float(v):.{n}f}" for v, n in zip(row.split(","), decimals, strict=True)) for row in rows]
        (ROOT / "sample_data" / path.name).write_text("\n".join([head, *short]) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
