"""Draw docs/pages/img/check.png: a drive over the sample site in DART, as logs, checked against its map.

    python docs/pictures/check.py FOLDER

The drive takes a minute; it is kept in FOLDER, with its logs and what `check` wrote. Needs the extra ``sim``, and
Chromium.
"""

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

import bumpymap
from bumpymap.check import CheckConfig, run_check
from bumpymap.layers import open_map
from bumpymap.rating import load_profile
from bumpytiles import TileWindow

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "worlds"))

from driven_ways import RecordSettings, ReliefGround, Stop, record_way
from sensed_drives import GOOD, read_motion, save_motion, sense_drive, write_drive_files

ROOT = Path(__file__).resolve().parents[2]
WAY = (
    *((92, 11), (36, 10), (14, 8), (14, 29), (60, 29), (116, 23)),
    *((118, 44), (98, 58), (84, 46), (50, 36), (19, 38), (19, 72)),
)
"""Clear of obstacles over meadow, road, ruts, rubble, floor, ramp; m east and north of the map's south-west corner."""
STOPS = (Stop(60.0, 4.0), Stop(150.0, 4.0))
SENSORS = replace(GOOD, mount_deg=(1.0, -2.0, 1.5), clock_offset_s=0.23, clock_drift_ppm=20.0)


def drive(layers: Path, motion: Path, way: tuple[tuple[int, int], ...] = WAY, stops: tuple[Stop, ...] = STOPS) -> None:
    """Drive over the ground of the map and keep the motion."""
    site = open_map(layers)
    bounds, size = site.grid.window_bounds(site.window), site.grid.tile_size
    line = np.array([bounds.west, bounds.south]) + np.array(way, float)
    low, high = np.floor(line.min(axis=0) / size).astype(int) - 3, np.ceil(line.max(axis=0) / size).astype(int) + 3
    window = TileWindow(*low.tolist(), *(high - low).tolist())
    ground = ReliefGround.from_heightmap(site.heights(window), site.grid.pixel_size, site.objects(window))
    _, made = record_way(load_profile("warthog"), ground, line - low * size, RecordSettings(stops=stops))
    save_motion(replace(made, place=made.place + np.array([*(low * size), 0.0])), motion)


def photograph(page: Path, picture: Path) -> None:
    """Show a page in Chromium as far as its charts, and keep the picture."""
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        shown = browser.new_page(viewport={"width": 1200, "height": 2600})
        shown.goto(page.resolve().as_uri())
        shown.wait_for_selector("html[data-ready]")
        height = shown.evaluate("document.querySelectorAll('figure')[2].getBoundingClientRect().bottom")
        shown.screenshot(path=picture, clip={"x": 0, "y": 0, "width": 1200, "height": height + 8})
        browser.close()


def main(folder: Path) -> None:
    """Map, drive, record, check; what is there already is used again."""
    folder.mkdir(parents=True, exist_ok=True)
    layers, motion = folder / "layers", folder / "motion.npz"
    if not (layers / "run.json").exists():
        bumpymap.map_survey(ROOT / "sample_data" / "quarry.laz", layers)
    if not motion.exists():
        drive(layers, motion)
    sensed = sense_drive(read_motion(motion), SENSORS, 1, "quarry", "EPSG:32632")
    logs = write_drive_files(sensed, folder)
    config = CheckConfig((",".join(map(str, logs)),), layers=layers, out=folder / "checked", overwrite=True)
    run_check(config)
    photograph(folder / "checked" / "check.html", ROOT / "docs" / "pages" / "img" / "check.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
