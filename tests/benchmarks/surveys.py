"""Make a large survey for the benchmarks: rough ground in LAS records of numbered points, swath by swath.

python tests/benchmarks/surveys.py --points 20000000 --format laz --data FOLDER

The position, height, colour and time of a point are functions of its number and the seed, so any number of them needs
no memory. A thousand million take 6.2 GB as LAZ; to make them takes about as long as to compress them.
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

_OCTAVES = 7
_LONGEST = 64.0
_STONE_CELL = 7.0


def _mix(value):
    """Hash numbers, uint64, to 64 bits (the finaliser of splitmix64)."""
    value = value + np.uint64(0x9E3779B97F4A7C15)
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


def _share(bits, first):
    """Return uniform numbers 0..1 from 16 of the bits."""
    return ((bits >> np.uint64(first)) & np.uint64(0xFFFF)).astype(np.float64) / 65536.0


def _corner(col, row, salt):
    along = col.astype(np.uint64) + (np.uint64(salt) << np.uint64(40))
    return _mix(_mix(along) ^ (row.astype(np.uint64) << np.uint64(20)))


def _noise(x, y, salt):
    """Return value noise: random heights -1..1 at integer x and y, smooth between them (x, y not negative)."""
    col, row = x.astype(np.int64), y.astype(np.int64)
    u, v = x - col, y - row
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    south = _share(_corner(col, row, salt), 0) * (1.0 - u) + _share(_corner(col + 1, row, salt), 0) * u
    north = _share(_corner(col, row + 1, salt), 0) * (1.0 - u) + _share(_corner(col + 1, row + 1, salt), 0) * u
    return 2.0 * (south * (1.0 - v) + north * v) - 1.0


def _stone(x, y, salt):
    """Return the height of the stone in the lattice cell at (x, y), m; 0 outside the stone."""
    col, row = (x / _STONE_CELL).astype(np.int64), (y / _STONE_CELL).astype(np.int64)
    bits = _corner(col, row, salt)
    radius = 0.3 + 0.9 * _share(bits, 16)
    dx = x - (col + 0.3 + 0.4 * _share(bits, 32)) * _STONE_CELL
    dy = y - (row + 0.3 + 0.4 * _share(bits, 48)) * _STONE_CELL
    inside = np.maximum(1.0 - (dx * dx + dy * dy) / (radius * radius), 0.0)
    return np.where(_share(bits, 0) > 0.25, 0.0, 0.8 * radius * np.sqrt(inside))


def _height(x, y, seed):
    """Return the height of the ground, m: hills, shorter and lower waves of varying strength, and stones."""
    share = 0.5 + 0.5 * _noise(x / 45.0, y / 45.0, seed)
    rough = 0.02 + 5.0 * share * share
    total, amplitude, step = 0.0, 4.0, _LONGEST
    for octave in range(_OCTAVES):
        wave = amplitude * _noise(x / step, y / step, seed + 1 + octave)
        total = total + (wave if octave < 3 else rough * wave)  # hills do not depend on the roughness
        amplitude *= 0.45
        step *= 0.45
    return total + _stone(x, y, seed + 100)


def fill_records(numbers, lines, seed, out):
    """Write the points of some numbers (n,) to records (n,) of point format 7, relative to the south-west corner.

    Number 0 is the first point of the first swath; a swath has ``lines`` scan lines, south to north, of ``SWATH``
    points each.
    """
    swath, place = np.divmod(numbers, SWATH * lines)
    line, across = np.divmod(place, SWATH)
    words = numbers.astype(np.uint64)
    bits, more = _mix(words ^ np.uint64(seed << 48)), _mix(words + np.uint64(1 << 60))
    x = (swath * SWATH + across + _share(bits, 0)) * SPACING
    y = (line + _share(bits, 16)) * SPACING
    # The sum of three uniform numbers of width 0.03 m is nearly normal, with 15 mm standard deviation.
    z = _height(x, y, seed) + 0.03 * (_share(bits, 32) + _share(bits, 48) + _share(more, 0) - 1.5)
    shade = 0.5 + 0.35 * _noise(x / 0.8, y / 0.8, seed + 200) + 0.1 * (_share(more, 16) - 0.5)
    for axis, metres in zip("XYZ", (x, y, z), strict=True):
        out[axis] = np.rint(metres / SCALE)
    out["intensity"] = 20000.0 * shade + 4000.0 * _share(more, 48)
    out["bit_fields"] = np.where(_share(more, 32) < 0.06, 0x22, 0x11)
    out["classification"] = 1
    out["scan_angle"] = np.rint((across - SWATH / 2) * 5000.0 / SWATH)
    out["point_source_id"] = 1 + swath
    out["gps_time"] = 3.994e8 + numbers * 4.2e-6 + swath * 30.0
    # Cameras record 8 bits; software writes them as the upper 8 of 16 bits.
    grain = _mix(more)
    for first, (band, dark, bright) in enumerate((("red", 40.0, 200.0), ("green", 50.0, 180.0), ("blue", 35.0, 150.0))):
        out[band] = (dark + bright * shade + 6.0 * _share(grain, 16 * first)).astype(np.uint16) << 8


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
            fill_records(numbers, lines, SEED, records)
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
