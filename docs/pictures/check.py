"""Draw docs/pages/img/check.png: the simulated drive of the samples, checked against the map of the sample site.

    python docs/pictures/check.py FOLDER

The map and what `check` wrote are kept in FOLDER. Needs Chromium.
"""

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

import bumpymap
from bumpymap.check import run_check
from bumpymap.core import CheckConfig

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "sample_data"


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
    """Map, check, photograph; a map that is there already is used again."""
    layers = folder / "layers"
    if not (layers / "run.json").exists():
        bumpymap.map_survey(SAMPLES / "quarry.laz", layers)
    drive = ",".join(str(SAMPLES / f"quarry_drive_{part}.csv") for part in ("imu", "gnss"))
    run_check(CheckConfig((drive,), layers=layers, out=folder / "checked", overwrite=True))
    photograph(folder / "checked" / "check.html", ROOT / "docs" / "pages" / "img" / "check.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
