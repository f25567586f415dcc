"""Make a wide site of few points for `bumpymap map --sheets`: strips of ground that cross, and single points between.

python tests/benchmarks/wide_site.py --out FOLDER

The site is cut into LAS files of 10 km x 10 km. The same settings give the same points, whatever the cut.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

_EPSG = 32632
_CORNER = (480_000.0, 5_340_000.0)
"""South-west corner of the site, m."""
_PIECE = 10_000.0
"""Side of a file, m."""
_CELL = 500.0
"""Side of the squares that points are made in, m: each has a seed of its own."""
_WAVES = ((1.3, 0.4), (2.1, 2.5), (3.7, 1.1), (5.9, 5.3))
"""Wavelength, m, and direction, rad, of the waves of the ground inside a tile."""


@dataclass(frozen=True, slots=True)
class WideSite:
    """A site to make. Lengths are in m."""

    width: float
    height: float
    spacing: float
    """Between the middles of two strips."""
    strip: float
    """Width of a strip."""
    density: float
    """Points per m2 in strips."""
    between: float
    """Points per m2 elsewhere."""
    seed: int

    def cell(self, west: float, south: float) -> NDArray[np.float64]:
        """Return the points of a square, (n, 3): coordinates, m."""
        number = [self.seed, round(west / _CELL), round(south / _CELL)]
        random = np.random.default_rng(number)
        half, middle = self.strip / 2, self.spacing / 2
        parts = [self._box(random, self.between, west, south, west + _CELL, south + _CELL)]
        for line in np.arange(middle, self.width, self.spacing):
            low, high = max(west, line - half), min(west + _CELL, line + half)
            parts += [self._box(random, self.density, low, south, high, south + _CELL)] if low < high else []
        for line in np.arange(middle, self.height, self.spacing):
            low, high = max(south, line - half), min(south + _CELL, line + half)
            parts += [self._box(random, self.density, west, low, west + _CELL, high)] if low < high else []
        flat = np.concatenate(parts)
        return np.column_stack([flat + _CORNER, self._ground(*flat.T)])

    @staticmethod
    def _box(
        random: np.random.Generator, density: float, west: float, south: float, east: float, north: float
    ) -> NDArray[np.float64]:
        count = random.poisson(density * (east - west) * (north - south))
        return random.uniform((west, south), (east, north), (count, 2))

    @staticmethod
    def _ground(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return heights: hills of some kilometres, and waves that are higher in some places than in others."""
        hills = 300.0 + 60.0 * np.sin(x / 3100.0) * np.cos(y / 2300.0)
        rough = 0.01 + 0.12 * np.clip(np.sin(x / 900.0) + np.cos(y / 700.0) - 0.6, 0.0, None)
        waves = sum(np.sin((x * np.cos(turn) + y * np.sin(turn)) * 2 * np.pi / length) for length, turn in _WAVES)
        return hills + rough * waves


def make(site: WideSite, folder: Path) -> int:
    """Write the files of a site; return the number of points."""
    folder.mkdir(parents=True, exist_ok=True)
    total = 0
    for west in np.arange(0.0, site.width, _PIECE):
        for south in np.arange(0.0, site.height, _PIECE):
            name = f"wide_{west / 1000:02.0f}_{south / 1000:02.0f}.las"
            total += _write(site, west, south, folder / name)
    return total


def _write(site: WideSite, west: float, south: float, path: Path) -> int:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.array([*_CORNER, 0.0])
    header.add_crs(CRS.from_epsg(_EPSG))
    total = 0
    with laspy.open(path, mode="w", header=header) as file:
        for left in np.arange(west, min(west + _PIECE, site.width), _CELL):
            for bottom in np.arange(south, min(south + _PIECE, site.height), _CELL):
                points = site.cell(left, bottom)
                record = laspy.ScaleAwarePointRecord.zeros(len(points), header=header)
                record.x, record.y, record.z = points.T
                record.return_number[:] = record.number_of_returns[:] = 1
                file.write_points(record)
                total += len(points)
    return total


def main() -> None:
    """Make a site as the command line says."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder of the files")
    parser.add_argument("--width", type=float, default=40.0, help="km")
    parser.add_argument("--height", type=float, default=30.0, help="km")
    parser.add_argument("--spacing", type=float, default=2.5, help="km between strips")
    parser.add_argument("--strip", type=float, default=42.0, help="width of a strip, m")
    parser.add_argument("--density", type=float, default=3.0, help="points per m2 in strips")
    parser.add_argument("--between", type=float, default=0.0004, help="points per m2 between strips")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    site = WideSite(
        given.width * 1000, given.height * 1000, given.spacing * 1000, given.strip, given.density, given.between,
        given.seed,
    )  # fmt: skip
    print(f"{make(site, given.out):,} points")


if __name__ == "__main__":
    main()
