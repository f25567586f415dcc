"""Draw index_page.png, of a batch, and report_page.png and route_quarry.png, of the sample without and with a way.

.venv/bin/python docs/pictures/pages.py docs/pages/img

It needs Chromium and Pillow (Debian and Ubuntu: chromium).
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import laspy
import numpy as np
import pyproj
from PIL import Image

import bumpymap

SAMPLE = Path(__file__).parents[2] / "sample_data" / "quarry.laz"
SIZE = 1280, 1400
"""Width and height of the browser's window for a batch, pixels; empty rows at the end are cut off."""
REPORT_SIZE = 1200, 800
"""The same for a map: the first screen of its page."""
ENDS = (512350.5, 5403300.5), (512450.5, 5403228.5)
"""Start and goal of the way on the sample, in its CRS."""
SIDE = 90.0
"""Side of a made-up site, m."""


def write_site(path: Path, density: float, west: float, south: float, epsg: int) -> None:
    """Write a survey of a made-up field: a lane through clods, a heap of rubble, points at random places."""
    random = np.random.default_rng(1)
    x, y = random.uniform(0, SIDE, (2, int(density * SIDE**2)))
    lane = np.clip(np.abs(y - 30 - 12 * np.sin(x / 18)) - 3.5, 0, 4) / 4
    clods = 0.09 * np.sin(2.1 * x + np.sin(y)) * np.sin(2.3 * y + np.sin(x))
    rubble = 0.5 * np.exp(-((x - 62) ** 2 + (y - 66) ** 2) / 160) * np.sin(4.1 * x) * np.sin(3.7 * y)
    z = 210 + 1.5 * np.sin(x / 25) + lane * clods + rubble + random.normal(0, 0.008, x.size)
    survey = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    survey.header.scales, survey.header.offsets = [0.001] * 3, [west, south, 0]
    survey.header.add_crs(pyproj.CRS.from_epsg(epsg))
    survey.x, survey.y, survey.z = x + west, y + south, z
    survey.write(path)


def draw(pictures: Path) -> None:
    """Map the surveys with `map_batch` and take pictures of its page and of that of the sample."""
    with tempfile.TemporaryDirectory() as scratch:
        flights, night = (Path(scratch) / name for name in ("flights", "night"))
        flights.mkdir()
        shutil.copy(SAMPLE, flights)
        write_site(flights / "field_may.laz", 60, 512_600, 5_403_200, 32632)
        write_site(flights / "field_thin.laz", 2.2, 512_720, 5_403_290, 32632)
        (flights / "field_cut.laz").write_bytes(SAMPLE.read_bytes()[:900_000])
        bumpymap.map_batch(flights, night)
        page = night / "index.html"
        page.write_text(page.read_text(encoding="utf-8").replace(f"{scratch}/", ""), encoding="utf-8")  # where it ran
        take(page, SIZE, pictures / "index_page.png")
        take(night / SAMPLE.stem / "report.html", REPORT_SIZE, pictures / "report_page.png")
        layers, way = bumpymap.open(night / SAMPLE.stem), Path(scratch) / "way"
        bumpymap.find_routes(layers, *ENDS, out=way)
        take(layers.report(route=way), REPORT_SIZE, pictures / "route_quarry.png")


def take(page: Path, size: tuple[int, int], picture: Path) -> None:
    """Take a picture of a page in Chromium."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        sys.exit("there is no chromium on this machine (Debian and Ubuntu: apt-get install chromium)")
    shot = page.with_name("shot.png")
    command = [browser, "--headless", "--no-sandbox", "--hide-scrollbars", f"--window-size={size[0]},{size[1]}"]
    command += ["--virtual-time-budget=3000", f"--screenshot={shot}", page.as_uri()]
    subprocess.run(command, check=True, capture_output=True, timeout=120)  # noqa: S603 (no shell, our own page)
    image = Image.open(shot).convert("RGB")
    pixels = np.asarray(image)
    used = np.flatnonzero((pixels != pixels[-1, -1]).any(axis=(1, 2)))
    image = image.crop((0, 0, size[0], min(size[1], int(used[-1]) + 24)))
    image.quantize(128, dither=Image.Dither.NONE).save(picture, optimize=True)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
