"""Make sample_data/quarry_dsm.tif and quarry_ortho.tif of the sample survey, as drone software makes them of a cloud.

The DSM has the highest point of each pixel of 10 cm, in whole centimetres, holes of up to 1 m filled. The orthophoto
shows the zones of the site in colours of their own, lit from the north-west.
"""

import sys
from pathlib import Path

import laspy
import numpy as np
import rasterio
from rasterio.fill import fillnodata
from rasterio.transform import from_origin
from scipy import ndimage

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "worlds"))

from made_quarry import BOUNDS, tiles_of

ROOT = Path(__file__).resolve().parents[2]

PIXEL_M, HOLE_M, STRAY_M = 0.1, 1.0, 5.0
TILE = round(3.0 / PIXEL_M)
COLOURS = {
    "R": (176, 168, 152),
    "W": (168, 156, 136),
    "U": (140, 116, 88),
    "X": (150, 146, 140),
    "S": (150, 148, 144),
    "P": (200, 200, 198),
    "/": (186, 170, 140),
    "B": (146, 128, 108),
    "A": (160, 152, 140),
    "f": (166, 150, 122),
    "m": (104, 128, 66),
    "o": (60, 82, 96),
    ".": (152, 142, 112),
}
CROWN = (52, 84, 40)
NONE = -32768


def main() -> None:
    """Write both files."""
    survey = laspy.read(ROOT / "sample_data" / "quarry.laz")
    kept = np.isin(survey.classification, (2, 5)) & (np.asarray(survey.withheld) == 0)
    x, y, z = (np.asarray(survey[axis])[kept] for axis in "xyz")
    rows, cols = (round(side / PIXEL_M) for side in (BOUNDS.north - BOUNDS.south, BOUNDS.east - BOUNDS.west))
    row = np.minimum(np.int64((BOUNDS.north - y) / PIXEL_M), rows - 1)
    place = row * cols + np.int64((x - BOUNDS.west) / PIXEL_M)
    top = np.full(rows * cols, -np.inf)
    np.maximum.at(top, place, z)
    top = top.reshape(rows, cols)
    filled = fillnodata(np.where(top > 0, top, 0), top > 0, HOLE_M / PIXEL_M)
    stray = np.abs(filled - ndimage.median_filter(filled, 9)) > STRAY_M
    filled = fillnodata(filled, (filled > 0) & ~stray, HOLE_M / PIXEL_M)
    place_of = {"crs": survey.header.parse_crs(), "transform": from_origin(BOUNDS.west, BOUNDS.north, PIXEL_M, PIXEL_M)}
    how = {"driver": "GTiff", "width": cols, "height": rows, "tiled": True, "blockxsize": 256, "blockysize": 256}
    with rasterio.open(
        ROOT / "sample_data" / "quarry_dsm.tif", "w", count=1, dtype="int16", nodata=NONE, compress="DEFLATE",
        predictor=2, zlevel=9, **place_of, **how,
    ) as file:  # fmt: skip
        file.scales, file.offsets, file.units = (0.01,), (400.0,), ("metre",)
        file.write(np.where(filled > 0, np.rint((filled - 400.0) * 100.0), NONE).astype(np.int16), 1)
    photo = np.zeros((rows // TILE, cols // TILE, 3))
    for symbol, colour in COLOURS.items():
        col, row = tiles_of(symbol)
        photo[round(BOUNDS.north / 3) - 1 - row, col - round(BOUNDS.west / 3)] = colour
    photo = ndimage.gaussian_filter(np.kron(photo, np.ones((TILE, TILE, 1))), (5, 5, 0))
    crown = np.zeros(rows * cols, bool)
    crown[place[np.asarray(survey.classification)[kept] == 5]] = True
    photo[ndimage.binary_closing(crown.reshape(rows, cols), iterations=2)] = CROWN
    south, east = np.gradient(
        ndimage.gaussian_filter(np.where(filled > 0, filled, filled[filled > 0].min()), 1.0), PIXEL_M
    )
    light = (1.0 + 0.7 * (south - east) / np.sqrt(2.0)) / np.sqrt(1.0 + south**2 + east**2)
    bands = np.clip(photo * np.clip(light, 0.35, 1.4)[..., None], 1, 255).astype(np.uint8)
    with rasterio.open(
        ROOT / "sample_data" / "quarry_ortho.tif", "w", count=3, dtype="uint8", compress="JPEG", jpeg_quality=80,
        photometric="YCBCR", **place_of, **how,
    ) as file:  # fmt: skip
        file.write(np.moveaxis(bands, -1, 0))


main()
