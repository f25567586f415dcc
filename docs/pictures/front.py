"""Draw the pictures of the README: a survey in three dimensions, its page on desk and phone, a scan, a way's profile.

.venv/bin/python docs/pictures/front.py SURVEY.laz CRS FROM TO FRAME.pcd docs/pages/img

SURVEY.laz is the drone survey that front.png shows, CRS its reference system, FROM and TO a way on it, x,y each;
FRAME.pcd a LiDAR scan. It needs what `bumpymap view` does, and Chromium.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from pages import take
from PIL import Image

COLOURS, HERO_PX, SMALL_PX = 200, 1200, 700
"""Most colours of a picture, and widths of the large and the small ones, px."""


def draw(survey: Path, crs: str, ends: tuple[str, str], frame: Path, pictures: Path) -> None:
    """Map, plan and scan, and write front.png, front_report.png, front_scan.png and front_route.png."""
    with tempfile.TemporaryDirectory() as scratch:
        layers, way, scan, hero = (Path(scratch) / name for name in ("map", "way", "scan", "hero.png"))
        run("map", survey, "--crs", crs, "--out", layers)
        run("route", layers, "--from", ends[0], "--to", ends[1], "--snap", 10, "--out", way)
        run("scan", frame, "--pictures", 1, "--out", scan)
        run("view", layers, "--route", way, "--out", hero)
        run("report", layers, "--route", way)
        save(Image.open(hero), pictures / "front.png", HERO_PX)
        save(on_both_screens(layers / "report.html"), pictures / "front_report.png", SMALL_PX)
        save(Image.open(next(scan.glob("frames/*.png"))), pictures / "front_scan.png", SMALL_PX)
        take(layers / "report.html", (1200, 790), way / "shot.png")
        save(Image.open(way / "shot.png").crop((0, 580, 1200, 790)), pictures / "front_route.png", SMALL_PX)


def run(*words: object) -> None:
    """Run a command of bumpymap."""
    subprocess.run([sys.executable, "-m", "bumpymap", *map(str, words)], check=True)  # noqa: S603 (our own command)


def on_both_screens(page: Path) -> Image.Image:
    """Return the first screen of a page on a desk and, beside it, on a phone."""
    shots = []
    for size in ((1440, 900), (390, 844)):
        shot = page.with_name(f"shot{size[0]}.png")
        take(page, size, shot)
        shots.append(Image.open(shot).convert("RGB"))
    high = max(shot.height for shot in shots)
    sheet = Image.new("RGB", (sum(shot.width for shot in shots) + 40, high), (120, 128, 138))
    sheet.paste(shots[0], (0, 0))
    sheet.paste(shots[1], (shots[0].width + 40, 0))
    return sheet


def save(picture: Image.Image, path: Path, width: int) -> None:
    """Write a picture, made smaller, as a small PNG."""
    picture = picture.convert("RGB")
    picture.thumbnail((width, 2 * width), Image.Resampling.LANCZOS)
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == "__main__":
    survey, crs, start, goal, frame, pictures = sys.argv[1:]
    draw(Path(survey), crs, (start, goal), Path(frame), Path(pictures))
