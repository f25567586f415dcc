"""Draw docs/pages/img/check.png: a drive over the sample site in DART, as logs, checked against its map.

    python docs/pictures/check.py FOLDER

The drive takes minutes; it is kept in FOLDER, with its logs and what `check` wrote. Needs the extra ``sim``.
"""

import shutil
import sys
from pathlib import Path

import numpy as np

import bumpymap
from bumpymap.lab.evaluate.routes.measured import driven_heights
from bumpymap.lab.simulate.drive_log import RecordSettings, record_way
from bumpymap.lab.simulate.relief import ReliefGround
from bumpymap.lab.simulate.way import Stop
from bumpymap.lab.worlds.drives import (
    GNSS,
    IMUS,
    ClockFault,
    DriveSensors,
    read_motion,
    save_motion,
    sense_drive,
    write_drive_files,
)
from bumpymap.layers import open_map
from bumpymap.rating import load_profile
from bumpytiles import TileWindow

ROOT = Path(__file__).resolve().parents[2]
STOPS = ((110, 8), (14, 8), (14, 29), (60, 29), (116, 23), (118, 44), (98, 58), (84, 46), (50, 36), (19, 38), (19, 72))
"""Metres east and north of the south-west corner of the map: meadow, road, ruts, rubble, floor, ramp."""


def drive(layers: Path, motion: Path) -> None:
    """Drive over the ground of the map and keep the motion."""
    site = open_map([layers])
    corner = np.array([site.grid.window_bounds(site.window).west, site.grid.window_bounds(site.window).south])
    line = corner + np.array(STOPS, float)
    size = site.grid.tile_size
    low, high = np.floor(line.min(axis=0) / size).astype(int) - 3, np.ceil(line.max(axis=0) / size).astype(int) + 3
    window = TileWindow(*low.tolist(), *(high - low).tolist())
    ground = ReliefGround.from_heightmap(
        driven_heights(site.heights(window), site.objects(window)), site.grid.pixel_size
    )
    settings = RecordSettings(stops=(Stop(60.0, 4.0), Stop(150.0, 4.0)))
    made = record_way(load_profile("warthog"), ground, line - low * size, settings)
    print(made.result.outcome, f"{made.result.path_m:.0f} m")
    place = made.motion.place + np.array([*(low * size), 0.0])
    from dataclasses import replace

    save_motion(replace(made.motion, place=place), motion)


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    layers, motion = folder / "layers", folder / "motion.npz"
    if not (layers / "run.json").exists():
        bumpymap.map_survey(ROOT / "sample_data" / "quarry.laz", layers)
    if not motion.exists():
        drive(layers, motion)
