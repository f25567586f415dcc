"""Draw a classified scan: sectors in the colours of their classes, points, obstacles, and a legend."""

import math
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from bumpymap.core import CLASSES, ClassedSectors, PolarCells, PolarSettings, Scan, cell_numbers
from bumpymap.layers import OBSTACLE_POINT, OTHER_POINT, SCAN_CLASS_NAMES, SCAN_COLOURS, class_index, point_styles

SIDE = 960
"""Side of the scene, pixels."""
_PANEL = 300
"""Width of the legend to the right of the scene, pixels."""
_PAPER, _INK, _FAINT_INK, _RING = (16, 18, 22), (235, 235, 235), (170, 174, 182), (120, 124, 132)
"""Colours of the background, of texts, of quieter ones, and of the range rings."""
_FILL = 0.42
"""Opacity of the class colour of a sector; points are opaque."""
_NOT_GROUND, _BORDER = (38, 40, 45), (58, 62, 70)
"""Colours of sectors without a class, and of borders between sectors."""
_HATCH_PX, _HATCH_WIDTH_PX, _HATCH = 14, 2, 0.6
"""Distance, width and opacity of the red lines over a sector with an obstacle."""
_STEPS_M, _FEWEST_RINGS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0), 3
"""Distances between range rings, m, of which the largest is taken that gives at least as many rings."""
_ROBOT = ((0, -15), (10, 12), (0, 7), (-10, 12))
"""Corners of the robot's symbol, an arrow head, pixels right and down from the sensor."""
_TEXT_PX, _SMALL_PX = 21, 17
"""Font sizes of names and of all other text, pixels."""
_SWATCH_PX, _MOST_NAME = 34, 24
"""Side of a colour in the legend, pixels; most characters of the name above it."""

Picture = NDArray[np.uint8]


def write_picture(scan: Scan, classed: ClassedSectors, path: Path, range_m: float = 40.0) -> None:
    """Draw a scan and write it as PNG."""
    paint(scan, classed, range_m).save(path, "PNG", compress_level=2)


def paint(scan: Scan, classed: ClassedSectors, range_m: float = 40.0) -> Image.Image:
    """Draw a scan.

    ``range_m``: distance from the sensor to the edge of the scene, m. Returns RGB, ``SIDE`` pixels high; the scene is
    square, with the legend to its right. Forward (x) is up, left (y) is left; the sensor is at the centre of the scene.
    """
    step = max((step for step in _STEPS_M if step * _FEWEST_RINGS <= range_m), default=range_m)
    picture: Picture = np.empty((SIDE, SIDE + _PANEL, 3), np.uint8)
    picture[:, SIDE:] = _PAPER
    _paint_sectors(picture[:, :SIDE], classed, range_m)
    _paint_points(picture, scan, point_styles(classed), range_m)
    row, column, strength = _ring_lines(range_m, step)
    under = picture[row, column]
    picture[row, column] = (under + strength[:, None] * (np.array(_RING) - under)).astype(np.uint8)
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    _draw_distances(draw, range_m, step)
    _draw_robot(draw, SIDE // 2, SIDE // 2)
    _draw_legend(draw, scan, classed, step)
    return image


@lru_cache(maxsize=2)
def _polar_pixels(range_m: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return distance (m) and azimuth (turns, -0.5 to 0.5) of every pixel of the scene."""
    middle = (np.arange(SIDE, dtype=np.float32) + 0.5) * np.float32(2.0 * range_m / SIDE) - np.float32(range_m)
    forward, left = -middle[:, None], -middle[None, :]
    return np.hypot(forward, left), np.arctan2(left, forward) / np.float32(2.0 * math.pi)


@lru_cache(maxsize=2)
def _polar_cells(settings: PolarSettings, range_m: float) -> PolarCells:
    return PolarCells.of(settings, *_polar_pixels(range_m))


def _paint_sectors(scene: Picture, classed: ClassedSectors, range_m: float) -> None:
    """Fill sectors with a shade of their colour, hatch those with an obstacle, and draw the borders of all cells."""
    stack, own = classed.sectors, cell_numbers(classed.sectors)
    count = int(np.dot(stack.settings.sectors, stack.settings.rings))
    paper = np.array(_PAPER, float)
    fill = np.vstack([paper + _FILL * (SCAN_COLOURS[:CLASSES] - paper), _NOT_GROUND]).astype(np.uint8)
    shades = np.full((2, count + 1, 3), _PAPER, np.uint8)  # second: of the lines of the hatching
    shades[:, own] = fill[class_index(classed)]
    barred = own[stack.obstacle]
    shades[1, barred] = shades[1, barred] + _HATCH * (SCAN_COLOURS[OBSTACLE_POINT] - shades[1, barred].astype(float))
    cell = _polar_cells(stack.settings, range_m).cells(stack.azimuth_start_rad)
    lines = np.add.outer(np.arange(SIDE), np.arange(SIDE)) % _HATCH_PX < _HATCH_WIDTH_PX
    np.take(shades.reshape(-1, 3), cell + len(shades[0]) * lines, axis=0, out=scene, mode="clip")
    border = np.zeros(cell.shape, np.bool_)
    border[:, 1:] = cell[:, 1:] != cell[:, :-1]
    border[1:] |= cell[1:] != cell[:-1]
    scene[border] = _BORDER


def _paint_points(picture: Picture, scan: Scan, styles: NDArray[np.uint8], range_m: float) -> None:
    """Paint points, obstacles larger: first what is not ground, then ground from smooth to rough, obstacles last."""
    with np.errstate(over="ignore"):
        place = np.floor((range_m - scan.points[:, :2].astype(np.float64)) * (SIDE / (2.0 * range_m)))
    inside = ((place >= 0) & (place < SIDE)).all(axis=1)
    row, column = place[inside].astype(np.int64).T
    styles = styles[inside]
    for style in (OTHER_POINT, *range(CLASSES), OBSTACLE_POINT):
        chosen = styles == style
        wide = 2 if style == OBSTACLE_POINT else 1
        for down, right in np.ndindex(wide, wide):
            rows, columns = np.minimum(row[chosen] + down, SIDE - 1), np.minimum(column[chosen] + right, SIDE - 1)
            picture[rows, columns] = SCAN_COLOURS[style]


@lru_cache(maxsize=2)
def _ring_lines(range_m: float, step: float) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """Return rows and columns of the pixels of the range rings, and the opacity of the ring in each."""
    distance = _polar_pixels(range_m)[0]
    off = np.abs(distance - step * np.maximum(np.rint(distance / np.float32(step)), 1.0))
    off *= np.float32(SIDE / 2 / range_m)
    row, column = np.nonzero(off < 1.2)
    return row, column, np.minimum(np.float32(1.2) - off[row, column], np.float32(0.8))


def _draw_distances(draw: ImageDraw.ImageDraw, range_m: float, step: float) -> None:
    """Label each range ring with its distance; a dark outline keeps labels readable over sectors and points."""
    for number in range(1, int(range_m / step + 1e-6) + 1):
        # On the diagonal, forward and to the right, clear of the robot and of the picture's edge.
        out = number * step * SIDE / 2 / range_m * math.sqrt(0.5)
        corner = (SIDE / 2 + out + 4, SIDE / 2 - out)
        draw.text(corner, f"{number * step:g} m", _INK, _font(_SMALL_PX), "lm", stroke_width=2, stroke_fill=_PAPER)


def _draw_robot(draw: ImageDraw.ImageDraw, column: int, row: int) -> None:
    draw.polygon([(column + right, row + down) for right, down in _ROBOT], _INK, _PAPER)


def _draw_legend(draw: ImageDraw.ImageDraw, scan: Scan, classed: ClassedSectors, step: float) -> None:
    stack = classed.sectors
    counts = np.bincount(class_index(classed), minlength=CLASSES + 1).tolist()
    classes = zip(SCAN_CLASS_NAMES, counts[:-1], strict=False)
    entries = [
        *((f"{name} ground", f"sectors: {count:,}") for name, count in classes),
        ("obstacle", f"hatched sectors: {int(stack.obstacle.sum()):,}"),
        ("not ground", f"sectors without ground: {counts[-1]:,}"),
    ]
    left, row = SIDE + 16, 24
    text = left + _SWATCH_PX + 14
    name = scan.name if len(scan.name) <= _MOST_NAME else f"{scan.name[: _MOST_NAME - 3]}..."
    draw.text((left, row), name, _INK, _font(_TEXT_PX), "lm")
    row += 36
    for colour, (name, count) in zip(SCAN_COLOURS.tolist(), entries, strict=True):
        draw.rectangle((left, row, left + _SWATCH_PX, row + _SWATCH_PX), tuple(colour))
        draw.text((text, row + 7), name, _INK, _font(_TEXT_PX), "lm")
        draw.text((text, row + 30), count, _FAINT_INK, _font(_SMALL_PX), "lm")
        row += 56
    row += 30
    _draw_robot(draw, left + _SWATCH_PX // 2, row)
    draw.text((text, row), "robot; forward is up", _INK, _font(_TEXT_PX), "lm")
    lines = [
        f"range rings every {step:g} m",
        f"whole frame: {len(scan.points):,} points,",
        f"{len(stack.zone):,} sectors",
    ]
    if not len(stack.zone):
        lines += ["", "no sector holds", f"more than {stack.settings.least_points} points"]
    draw.multiline_text((left, row + 36), "\n".join(lines), _INK, _font(_SMALL_PX), spacing=10)


@lru_cache(maxsize=16)
def _font(size: int) -> ImageFont.FreeTypeFont:
    """Return Pillow's own font with Pillow's own layout engine, so that pixels are the same on every machine."""
    found = ImageFont.load_default(size)
    if not isinstance(found, ImageFont.FreeTypeFont):
        raise TypeError("this Pillow was built without FreeType")
    return found.font_variant(layout_engine=ImageFont.Layout.BASIC)
