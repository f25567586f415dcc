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
    cuts: int = 1
    """Files along each side of the site; 1: one file."""

    @property
    def name(self) -> str:
        """Name of the file, or of the folder of files that adjoin; contains all settings."""
        base = f"site_{self.points}_{self.order}_{self.seed}"
        if self.cuts > 1:
            return f"{base}_{self.format}_{self.cuts}x{self.cuts}"
        return f"{base}.{self.format}"

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

    def numbers_of_part(self, column: int, row: int) -> Iterator[NDArray[np.int64]]:
        """Yield the numbers of the points of one of the files that adjoin, in flight order."""
        width = self.swaths * SWATH
        west, east = (width * side // self.cuts for side in (column, column + 1))
        south, north = (self.lines * side // self.cuts for side in (row, row + 1))
        for swath in range(west // SWATH, (east - 1) // SWATH + 1):
            across = np.arange(max(west, swath * SWATH), min(east, (swath + 1) * SWATH)) % SWATH
            step = max(1, _BATCH // len(across))
            for first in range(south, north, step):
                lines = np.arange(first, min(first + step, north))[:, None]
                numbers = ((swath * self.lines + lines) * SWATH + across).ravel()
                yield numbers[numbers < self.points]


def make(survey: Survey, folder: Path) -> Path:
    """Make a survey unless it exists; the file, or the folder of files, appears whole."""
    path = folder / survey.name
    if path.exists():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    _refuse_full_disk(survey, folder)
    started = time.perf_counter()
    beside = path.with_name(path.name + ".part")
    try:
        if survey.cuts > 1:
            shutil.rmtree(beside, ignore_errors=True)
            beside.mkdir()
            for column, row in np.ndindex(survey.cuts, survey.cuts):
                part = beside / f"part_{column}_{row}.{survey.format}"
                _write(part, survey, survey.numbers_of_part(column, row))
        else:
            _write(beside, survey, survey.numbers())
        beside.rename(path)
    finally:
        if beside.is_dir():
            shutil.rmtree(beside)
        beside.unlink(missing_ok=True)
    seconds = time.perf_counter() - started
    sys.stderr.write(f"made {path.name}: {_size(path) / 1e9:.2f} GB in {seconds:.0f} s\n")
    return path


def _write(path: Path, survey: Survey, batches: Iterator[NDArray[np.int64]]) -> None:
    """Write the points of some numbers as LAS or LAZ."""
    header = _header()
    with laspy.open(
        path,
        mode="w",
        header=header,
        do_compress=survey.format == "laz",
        laz_backend=laspy.LazBackend.LazrsParallel,
    ) as writer:
        for numbers in batches:
            records = np.zeros(len(numbers), header.point_format.dtype())
            fill_records(numbers, survey.lines, survey.seed, records)
            writer.write_points(
                laspy.ScaleAwarePointRecord(records, header.point_format, header.scales, header.offsets)
            )


def _files(path: Path) -> list[Path]:
    """Return the files of a survey: the file itself, or those in a folder."""
    return sorted(path.iterdir()) if path.is_dir() else [path]


def _size(path: Path) -> int:
    return sum(file.stat().st_size for file in _files(path))


def facts(path: Path) -> dict[str, float | int | str]:
    """Describe a LAS or LAZ file, or a folder of them: points, bytes, extent, format."""
    headers = []
    for file in _files(path):
        with laspy.open(file) as reader:
            headers.append(reader.header)
    width, depth, height = (
        float(side)
        for side in np.max([each.maxs for each in headers], axis=0) - np.min([each.mins for each in headers], axis=0)
    )
    kind = "LAS" if file.suffix.lower() == ".las" else "LAZ"
    return {
        "points": sum(each.point_count for each in headers),
        "bytes": _size(path),
        "width_m": width,
        "depth_m": depth,
        "height_m": height,
        "kind": f"{kind} {headers[0].version}, point format {headers[0].point_format.id}",
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
    parser.add_argument(
        "--cuts", type=int, default=1, help="files along each side of the site, as 4 for 16 that adjoin"
    )
    parser.add_argument("--facts", type=Path, metavar="FILE", help="describe FILE (or a folder) only")
    given = parser.parse_args()
    if given.points < 1:
        parser.error(f"--points is {given.points}; it must be at least 1")
    if given.cuts < 1:
        parser.error(f"--cuts is {given.cuts}; it must be at least 1")
    if given.order == "shuffled" and given.cuts > 1:
        parser.error("--order shuffled is for one file; leave out --cuts")
    survey = Survey(given.points, given.order, given.format, given.seed, given.cuts)
    path = given.facts or make(survey, given.data)
    print(json.dumps({"path": str(path), **facts(path)}))


if __name__ == "__main__":
    main()
