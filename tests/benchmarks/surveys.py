"""Make a large survey for the benchmarks: rough ground in LAS records of numbered points, swath by swath.

python tests/benchmarks/surveys.py --points 20000000 --format laz --data FOLDER

The ground is a function of the place, and points are made a million at a time, so any number of them needs no memory. A
thousand million take 6.2 GB as LAZ; to make them takes about as long as to compress them.
"""

import argparse
import math
from pathlib import Path

import laspy
import numpy as np
from pyproj import CRS

SEED = 1
SCALE = 1e-3
"""Resolution of the coordinates, m."""
SPACING = 1.0 / math.sqrt(220.0)
"""Mean distance between neighbouring points, m: 220 points/m2."""
SWATH = 1024
"""Points across a swath."""
_CORNER = (691_200.0, 5_335_800.0, 0.0)
"""South-west corner of every site in EPSG:32632, m."""
_BATCH = 1_000_000

_LENGTHS = 64.0 * 0.45 ** np.arange(7)
"""Of the waves of the ground, m; each kind is 0.45 times as high as the one before, the first 4 m."""
_TURNS, _PHASES = np.random.default_rng(SEED).uniform(0.0, 2.0 * np.pi, (2, len(_LENGTHS) + 2, 3))
_STONE_CELL = 7.0
"""Side of the squares of which one in four holds a stone, m."""


def _wave(x, y, length, number):
    """Return the mean of three sines of a length [m], each in a direction of its own."""
    along = (np.cos(turn) * x + np.sin(turn) * y for turn in _TURNS[number])
    return sum(np.sin(2.0 * np.pi / length * a + p) for a, p in zip(along, _PHASES[number], strict=True)) / 3.0


def _stone(x, y):
    """Return the height of the stone in the square at (x, y), m; 0 outside the stone."""
    col, row = np.floor(x / _STONE_CELL), np.floor(y / _STONE_CELL)
    seen, size, east, north = (
        np.modf(43758.5453 * np.abs(np.sin(12.9898 * col + 78.233 * row + 37.719 * number)))[0] for number in range(4)
    )  # numbers 0..1 that belong to the square
    radius = 0.3 + 0.9 * size
    dx, dy = x - (col + 0.3 + 0.4 * east) * _STONE_CELL, y - (row + 0.3 + 0.4 * north) * _STONE_CELL
    inside = np.maximum(1.0 - (dx * dx + dy * dy) / (radius * radius), 0.0)
    return np.where(seen > 0.25, 0.0, 0.8 * radius * np.sqrt(inside))


def _height(x, y):
    """Return the height of the ground, m: hills, shorter and lower waves of varying strength, and stones."""
    rough = 0.02 + 5.0 * (0.5 + 0.5 * _wave(x, y, 45.0, -1)) ** 2
    total = _stone(x, y)
    for octave, length in enumerate(_LENGTHS):
        wave = 4.0 * 0.45**octave * _wave(x, y, length, octave)
        total += wave if octave < 3 else rough * wave  # hills do not depend on the roughness
    return total


def fill_records(numbers, lines, rng, out):
    """Write the points of some numbers (n,) to records (n,) of point format 7, relative to the south-west corner.

    Number 0 is the first point of the first swath; a swath has ``lines`` scan lines, south to north, of ``SWATH``
    points each.
    """
    swath, place = np.divmod(numbers, SWATH * lines)
    line, across = np.divmod(place, SWATH)
    x = (swath * SWATH + across + rng.random(len(numbers))) * SPACING
    y = (line + rng.random(len(numbers))) * SPACING
    z = _height(x, y) + rng.normal(0.0, 0.015, len(numbers))
    shade = 0.5 + 0.35 * _wave(x, y, 0.8, -2) + rng.uniform(-0.05, 0.05, len(numbers))
    for axis, metres in zip("XYZ", (x, y, z), strict=True):
        out[axis] = np.rint(metres / SCALE)
    out["intensity"] = 20000.0 * shade + rng.uniform(0.0, 4000.0, len(numbers))
    out["bit_fields"] = np.where(rng.random(len(numbers)) < 0.06, 0x22, 0x11)
    out["classification"] = 1
    out["scan_angle"] = np.rint((across - SWATH / 2) * 5000.0 / SWATH)
    out["point_source_id"] = 1 + swath
    out["gps_time"] = 3.994e8 + numbers * 4.2e-6 + swath * 30.0
    # Cameras record 8 bits; software writes them as the upper 8 of 16 bits.
    for band, dark, bright in (("red", 40.0, 200.0), ("green", 50.0, 180.0), ("blue", 35.0, 150.0)):
        out[band] = (dark + bright * shade + rng.uniform(0.0, 6.0, len(numbers))).astype(np.uint16) << 8


def make(points, path):
    """Write a survey to a path ending with .las or .laz; the site is about square, and the file appears whole."""
    header = laspy.LasHeader(version="1.4", point_format=7)
    header.scales, header.offsets = np.full(3, SCALE), np.array(_CORNER)
    header.generating_software = "bumpymap benchmarks"
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.add_crs(CRS.from_epsg(32632))
    lines = math.ceil(points / (SWATH * max(1, round(math.sqrt(points) / SWATH))))
    beside, backend = path.with_name(path.name + ".part"), laspy.LazBackend.LazrsParallel
    with laspy.open(beside, "w", header=header, do_compress=path.suffix == ".laz", laz_backend=backend) as writer:
        for first in range(0, points, _BATCH):
            numbers = np.arange(first, min(first + _BATCH, points))
            records = np.zeros(len(numbers), header.point_format.dtype())
            fill_records(numbers, lines, np.random.default_rng([SEED, first]), records)
            writer.write_points(
                laspy.ScaleAwarePointRecord(records, header.point_format, header.scales, header.offsets)
            )
    beside.rename(path)


def main():
    """Make a survey unless it exists; print its path."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the surveys")
    parser.add_argument("--points", type=int, default=20_000_000)
    parser.add_argument("--format", choices=("laz", "las"), default="laz")
    given = parser.parse_args()
    path = given.data / f"site_{given.points}_{SEED}.{given.format}"
    if not path.exists():
        given.data.mkdir(parents=True, exist_ok=True)
        make(given.points, path)
    print(path)


if __name__ == "__main__":
    main()
