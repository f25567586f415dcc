"""Write frames/NAME.png: a scan from above, forward up, sectors and points in the colours of their classes.

The sector of every pixel follows from its distance and azimuth, so sectors, points and range rings are painted directly
in the pixel array. Pillow draws text and arrows with its own font, so pictures do not depend on installed fonts.
"""

import math
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from bumpymap.core import CLASSES, NOT_TRAVERSABLE, ClassedSectors, PolarSettings, Scan, SectorStack, sector_bounds
from bumpymap.layers._font import font
from bumpymap.layers.scan.style import SCAN_CLASS_NAMES, SCAN_COLOURS, style_index

__all__ = ["SIDE", "paint", "scene_radius", "write_picture"]

SIDE = 960
"""Side of the scene, pixels."""
_PANEL = 300
"""Width of the legend to the right of the scene, pixels."""
_PAPER, _INK, _FAINT_INK, _RING = (16, 18, 22), (235, 235, 235), (170, 174, 182), (120, 124, 132)
_FILL = 0.42
"""Opacity of the class colour of a sector; points are opaque."""
_BORDER = 0.7
"""Brightness factor of the border between sectors."""
_STEPS_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
_FEWEST_RINGS = 3
_ARROW = ((0, -16), (12, 14), (0, 9), (-12, 14))
"""Corners of the forward arrow, pixels right and down from the sensor."""
_TEXT_PX, _SMALL_PX = 21, 17
"""Font sizes of names and of all other text, pixels."""
_SWATCH_PX = 34

Picture = NDArray[np.uint8]


def write_picture(scan: Scan, classed: ClassedSectors, path: Path) -> None:
    """Draw a scan and write it as PNG."""
    paint(scan, classed).save(path, "PNG", compress_level=4)


def paint(scan: Scan, classed: ClassedSectors) -> Image.Image:
    """Draw a scan.

    Returns
    -------
    Image
        RGB, ``SIDE`` pixels high; the scene is square, with the legend to its right. Forward (x) is up, left (y) is
        left; the sensor is at the centre of the scene.
    """
    reach = scene_radius(classed.sectors)
    step = _ring_step(reach)
    picture: Picture = np.full((SIDE, SIDE + _PANEL, 3), _PAPER, np.uint8)
    picture[:, :SIDE] = _scene(scan, classed, reach, step)
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    _draw_distances(draw, reach, step)
    _draw_arrow(draw, SIDE // 2, SIDE // 2)
    _draw_legend(draw, scan, classed, step)
    return image


def _scene(scan: Scan, classed: ClassedSectors, reach: float, step: float) -> Picture:
    """Return the square around the sensor, (SIDE, SIDE, 3): sectors, points over them, range rings over both."""
    scene: Picture = np.full((SIDE, SIDE, 3), _PAPER, np.uint8)
    _paint_sectors(scene, classed, reach)
    _paint_points(scene, scan, classed, reach)
    place, strength = _ring_lines(reach, step)
    under = scene.reshape(-1, 3)[place]
    scene.reshape(-1, 3)[place] = (under + strength[:, None] * (np.array(_RING) - under)).astype(np.uint8)
    return scene


def scene_radius(stack: SectorStack) -> float:
    """Return the half width of the scene, m: the far end of the farthest sector, at least that of the first zone."""
    first = (*stack.settings.zone_starts_m[1:], stack.settings.end_m)[0]
    return float(sector_bounds(stack).far.max(initial=first))


@lru_cache(maxsize=2)
def _polar_pixels(reach: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return distance (m) and azimuth (turns, -0.5 to 0.5) of every pixel of the scene."""
    middle = (np.arange(SIDE, dtype=np.float32) + 0.5) * np.float32(2.0 * reach / SIDE) - np.float32(reach)
    forward, left = -middle[:, None], -middle[None, :]
    return np.hypot(forward, left), np.arctan2(left, forward) / np.float32(2.0 * math.pi)


def _paint_sectors(scene: Picture, classed: ClassedSectors, reach: float) -> None:
    """Fill sectors with a shade of their colour, darker at the borders of grid cells."""
    stack, first = classed.sectors, _first_cells(classed.sectors.settings)
    own = first[stack.zone] + stack.ring * np.array(stack.settings.sectors)[stack.zone] + stack.sector
    shades = np.full((first[-1] + 1, 3), _PAPER, np.uint8)
    colours = SCAN_COLOURS[style_index(classed.class_id, np.arange(len(own), dtype=np.int32))]
    shades[own] = (np.array(_PAPER) + _FILL * (colours - np.array(_PAPER, float))).astype(np.uint8)
    cell = _cells(stack.settings, stack.azimuth_start_rad, reach)
    scene[:] = shades[cell]
    border = np.zeros(cell.shape, np.bool_)
    border[:, 1:] |= cell[:, 1:] != cell[:, :-1]
    border[1:] |= cell[1:] != cell[:-1]
    scene[border] = (scene[border] * _BORDER).astype(np.uint8)


def _first_cells(settings: PolarSettings) -> NDArray[np.int64]:
    """Return the index of the first cell of each zone (cells in zone, ring, sector order), then the number of cells."""
    return np.concatenate([[0], np.cumsum(np.array(settings.sectors) * settings.rings)])


def _cells(settings: PolarSettings, azimuth_start: float, reach: float) -> NDArray[np.int32]:
    """Return the index of the grid cell of every pixel; outside the grid, the number of cells."""
    base, sectors = _ring_pixels(settings, reach)
    share = _polar_pixels(reach)[1] - np.float32(azimuth_start / (2.0 * math.pi))
    share -= np.floor(share)
    share *= sectors
    cell: NDArray[np.int32] = base + np.minimum(share, np.maximum(sectors - 1, 0)).astype(np.int32)
    return cell


@lru_cache(maxsize=2)
def _ring_pixels(settings: PolarSettings, reach: float) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return, for every pixel, the first cell of its ring and the ring's number of sectors (0 outside the grid)."""
    distance, _ = _polar_pixels(reach)
    edges = np.array([*settings.zone_starts_m, settings.end_m], np.float32)
    zone = np.searchsorted(edges, distance, side="right") - 1
    outside = (zone < 0) | (zone >= len(settings.sectors))
    zone[outside] = 0
    rings, sectors = np.array(settings.rings), np.array(settings.sectors)
    ring = ((distance - edges[zone]) / np.diff(edges)[zone] * rings[zone]).astype(np.int64)
    first = _first_cells(settings)
    base = first[zone] + np.minimum(ring, rings[zone] - 1) * sectors[zone]
    return np.where(outside, first[-1], base).astype(np.int32), np.where(outside, 0, sectors[zone]).astype(np.float32)


def _paint_points(scene: Picture, scan: Scan, classed: ClassedSectors, reach: float) -> None:
    """Paint points: those without a sector first, then from smooth to rough."""
    styles = style_index(classed.class_id, classed.sectors.point_sector)
    with np.errstate(over="ignore"):
        place = np.floor((reach - scan.points[:, :2].astype(np.float64)) * (SIDE / (2.0 * reach)))
    inside = ((place >= 0) & (place < SIDE)).all(axis=1)
    row, column = place[inside].astype(np.int64).T
    styles = styles[inside]
    for style in (len(SCAN_COLOURS) - 1, *range(len(SCAN_COLOURS) - 1)):
        chosen = styles == style
        scene[row[chosen], column[chosen]] = SCAN_COLOURS[style]


def _ring_step(reach: float) -> float:
    """Return the distance between range rings, m, so that at least three fit."""
    return max((step for step in _STEPS_M if step * _FEWEST_RINGS <= reach), default=reach)


@lru_cache(maxsize=2)
def _ring_lines(reach: float, step: float) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return the pixels of the range rings and the opacity of the ring in each."""
    distance = _polar_pixels(reach)[0].reshape(-1)
    off = np.abs(distance - step * np.maximum(np.rint(distance / np.float32(step)), 1.0)) * np.float32(SIDE / 2 / reach)
    place = np.flatnonzero(off < 1.2)
    return place, np.minimum(np.float32(1.2) - off[place], np.float32(0.8))


def _draw_distances(draw: ImageDraw.ImageDraw, reach: float, step: float) -> None:
    """Label each range ring with its distance; a dark outline keeps labels readable over sectors and points."""
    for number in range(1, int(reach / step + 1e-6) + 1):
        # On the diagonal, forward and to the right, clear of the arrow and of the picture's edge.
        out = number * step * SIDE / 2 / reach * math.sqrt(0.5)
        corner = (SIDE / 2 + out + 4, SIDE / 2 - out)
        draw.text(corner, f"{number * step:g} m", _INK, font(_SMALL_PX), "lm", stroke_width=2, stroke_fill=_PAPER)


def _draw_arrow(draw: ImageDraw.ImageDraw, column: int, row: int) -> None:
    """Draw the forward arrow at the position of the sensor."""
    draw.polygon([(column + right, row + down) for right, down in _ARROW], _INK, _PAPER)


def _draw_legend(draw: ImageDraw.ImageDraw, scan: Scan, classed: ClassedSectors, step: float) -> None:
    stack = classed.sectors
    sectors = np.bincount(
        np.where(classed.class_id == NOT_TRAVERSABLE, CLASSES, classed.class_id), minlength=CLASSES + 1
    )
    outside = int((stack.point_sector < 0).sum())
    left, row = SIDE + 16, 40
    text = left + _SWATCH_PX + 14
    for style, name in enumerate(SCAN_CLASS_NAMES):
        draw.rectangle((left, row, left + _SWATCH_PX, row + _SWATCH_PX), tuple(SCAN_COLOURS[style].tolist()))
        draw.text((text, row + 7), name, _INK, font(_TEXT_PX), "lm")
        count = f"{outside:,} points" if style > CLASSES else f"{sectors[style]:,} sectors"
        draw.text((text, row + 30), count, _FAINT_INK, font(_SMALL_PX), "lm")
        row += 56
    row += 30
    _draw_arrow(draw, left + _SWATCH_PX // 2, row)
    draw.text((text, row), "forward", _INK, font(_TEXT_PX), "lm")
    lines = [f"range rings every {step:g} m", f"{len(scan.points):,} points in the scan"]
    if not len(stack.zone):
        lines += ["", "no sector holds", f"more than {stack.settings.least_points} points"]
    draw.multiline_text((left, row + 36), "\n".join(lines), _INK, font(_SMALL_PX), spacing=10)
