"""Make the large surveys for the benchmarks; the same seed gives the same points.

python tests/benchmarks/surveys.py --points 20000000 --order sorted --format laz --data FOLDER

A thousand million points take 6.2 GB as LAZ; to make them takes about as long as to compress them.
"""

import argparse
import json
import math
import shutil
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import laspy
import numpy as np
from _ground import SCALE, SWATH, fill_records, scramble
from numpy.typing import NDArray
from pyproj import CRS

ORDERS = ("sorted", "shuffled")
FORMATS = ("laz", "las")
_PARALLEL = laspy.LazBackend.LazrsParallel

_EPSG = 32632
_CORNER = (691_200.0, 5_335_800.0, 0.0)
"""South-west corner of every site, m."""
_BATCH = 1_000_000
_BYTES = {"las": {"sorted": 36, "shuffled": 36}, "laz": {"sorted": 7, "shuffled": 20}}
"""Format -> order -> bytes per point on disk, rounded up."""
_SPARE = 1_000_000_000
"""Bytes of disk space to keep free."""


@dataclass(frozen=True, slots=True)
class Survey:
    """One survey to make."""

    points: int
    order: str
    """``sorted``: swath by swath, line by line; ``shuffled``: in random order over the site."""
    format: str
    seed: int = 1

    @property
    def name(self) -> str:
        """Name of the file; contains all settings."""
        return f"site_{self.points}_{self.order}_{self.seed}.{self.format}"

    @property
    def swaths(self) -> int:
        """Swaths of the site."""
        return max(1, round(math.sqrt(self.points) / SWATH))

    @property
    def lines(self) -> int:
        """Number of scan lines per swath that makes the site about square."""
        return math.ceil(self.points / (SWATH * self.swaths))

    def numbers(self) -> Iterator[NDArray[np.int64]]:
        """Yield the numbers of the points of a file in its order, in batches."""
        if self.order == "sorted":
            for first in range(0, self.points, _BATCH):
                yield np.arange(first, min(first + _BATCH, self.points))
            return
        half_bits = math.ceil((self.points - 1).bit_length() / 2)
        for first in range(0, 4**half_bits, _BATCH):
            yield scramble(first, min(_BATCH, 4**half_bits - first), half_bits, self.points, self.seed)


def make(survey: Survey, folder: Path) -> Path:
    """Make a survey unless it exists; the file appears whole."""
    path = folder / survey.name
    if path.exists():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    _refuse_full_disk(survey, folder)
    started = time.perf_counter()
    beside, header = path.with_name(path.name + ".part"), _header()
    compress = survey.format == "laz"
    try:
        with laspy.open(beside, "w", header=header, do_compress=compress, laz_backend=_PARALLEL) as writer:
            for numbers in survey.numbers():
                records = np.zeros(len(numbers), header.point_format.dtype())
                fill_records(numbers, survey.lines, survey.seed, records)
                points = laspy.ScaleAwarePointRecord(records, header.point_format, header.scales, header.offsets)
                writer.write_points(points)
        beside.rename(path)
    finally:
        beside.unlink(missing_ok=True)
    seconds = time.perf_counter() - started
    sys.stderr.write(f"made {path.name}: {path.stat().st_size / 1e9:.2f} GB in {seconds:.0f} s\n")
    return path


def facts(path: Path) -> dict[str, float | int | str]:
    """Describe a LAS or LAZ file: points, bytes, extent, format."""
    with laspy.open(path) as reader:
        header = reader.header
    width, depth, height = (header.maxs - header.mins).tolist()
    kind = "LAS" if path.suffix.lower() == ".las" else "LAZ"
    return {
        "points": header.point_count,
        "bytes": path.stat().st_size,
        "width_m": width,
        "depth_m": depth,
        "height_m": height,
        "kind": f"{kind} {header.version}, point format {header.point_format.id}",
    }


def _header() -> laspy.LasHeader:
    header = laspy.LasHeader(version="1.4", point_format=7)
    header.scales = np.full(3, SCALE)
    header.offsets = np.array(_CORNER)
    header.generating_software = "bumpymap benchmarks"
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.add_crs(CRS.from_epsg(_EPSG))
    return header


def _refuse_full_disk(survey: Survey, folder: Path) -> None:
    needed = survey.points * _BYTES[survey.format][survey.order] + _SPARE
    free = shutil.disk_usage(folder).free
    if free < needed:
        sys.exit(
            f"{survey.name} may need {needed / 1e9:.1f} GB and {folder} has {free / 1e9:.1f} GB free. "
            "Free some space, or choose a folder on a larger disk: --data FOLDER"
        )


def main() -> None:
    """Make one survey, or describe a file with --facts; print one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).with_name("data"), help="folder of the surveys")
    parser.add_argument("--points", type=int, default=20_000_000)
    parser.add_argument("--order", choices=ORDERS, default="sorted")
    parser.add_argument("--format", choices=FORMATS, default="laz")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--facts", type=Path, metavar="FILE", help="describe FILE only")
    given = parser.parse_args()
    if given.points < 1:
        parser.error(f"--points is {given.points}; it must be at least 1")
    survey = Survey(given.points, given.order, given.format, given.seed)
    path = given.facts or make(survey, given.data)
    print(json.dumps({"path": str(path), **facts(path)}))


if __name__ == "__main__":
    main()
