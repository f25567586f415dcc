"""Write the synthetic survey: a LAZ file, and a PLY file of a part of it. The same points give the same bytes."""

import datetime as dt
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import laspy
import numpy as np
from pyproj import CRS

from bumpymap.core import OutputError, atomic, write_vertices
from bumpymap.lab.worlds.sample.site import EPSG, QuarrySite
from bumpymap.lab.worlds.sample.survey import SCALE, SurveyPoints, sample_survey
from bumpytiles import Bounds

__all__ = ["SampleFiles", "make_quarry_survey", "part_bounds", "write_laz", "write_ply"]

_FLOWN_ON = dt.date(2024, 5, 14)
_FIRST_PULSE = 3.994e8
"""GPS time of the first pulse, on that day, minus 1e9 s."""


@dataclass(frozen=True, slots=True)
class SampleFiles:
    """Paths of the files written by ``make_quarry_survey``."""

    survey: Path
    """LAZ of the whole site."""
    part: Path
    """PLY of ``part_bounds``."""


def part_bounds(site: QuarrySite) -> Bounds:
    """Return the bounds of the PLY file, m: washboard, floor and a corner of the pad."""
    box = site.bounds
    return Bounds(box.west + 48.0, box.south + 27.0, box.west + 69.0, box.south + 48.0)


def make_quarry_survey(folder: Path, seed: int = 1, density: float = 100.0, area: Bounds | None = None) -> SampleFiles:
    """Make the sample survey: ``quarry.laz`` and ``quarry_part.ply``.

    Parameters
    ----------
    folder : Path
        Created if it does not exist; existing files are replaced.
    seed : int
        Seed of ``QuarrySite`` and of the flight.
    density : float
        Mean points per square metre.
    area : Bounds, optional
        Part of the site to survey, m; the whole site by default.

    Returns
    -------
    SampleFiles

    Raises
    ------
    OutputError
        The folder cannot be written.
    ValueError
        The settings are invalid or give too few points.
    """
    site = QuarrySite(seed)
    points = sample_survey(site, density, area)
    box = part_bounds(site)
    within = (points.easting >= box.west) & (points.easting < box.east)
    within &= (points.northing >= box.south) & (points.northing < box.north)
    within &= ~points.withheld & (points.classification != 7)
    files = SampleFiles(folder / "quarry.laz", folder / "quarry_part.ply")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write the sample survey to {folder}: {error}. Choose another folder") from error
    with atomic(files.survey) as beside, beside.open("w+b") as stream:
        write_laz(points, site, stream)
    with atomic(files.part) as beside, beside.open("w+b") as stream:
        write_ply(points.select(within), stream)
    return files


def write_laz(points: SurveyPoints, site: QuarrySite, stream: BinaryIO) -> None:
    """Write LAZ 1.4, point format 6, CRS as WKT; the offset is the corner of the site."""
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales = np.full(3, SCALE)
    header.offsets = np.array([site.bounds.west, site.bounds.south, 0.0])
    header.creation_date = _FLOWN_ON
    header.system_identifier = "bumpymap QuarrySite"
    header.generating_software = "bumpymap.lab.worlds.sample"
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.add_crs(CRS.from_epsg(EPSG))
    survey = laspy.LasData(header)
    survey.x, survey.y, survey.z = points.easting, points.northing, points.upward
    survey.classification = points.classification
    survey.withheld = points.withheld.astype(np.uint8)
    survey.return_number = np.ones(points.line.size, dtype=np.uint8)
    survey.number_of_returns = np.ones(points.line.size, dtype=np.uint8)
    survey.point_source_id = points.line
    survey.gps_time = _FIRST_PULSE + points.gps_time
    survey.write(stream, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)


def write_ply(points: SurveyPoints, stream: BinaryIO) -> None:
    """Write binary little-endian PLY: x, y, z as double, classification as uchar."""
    kind = [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("classification", "u1")]
    vertex = np.empty(points.easting.size, dtype=kind)
    columns = (points.easting, points.northing, points.upward, points.classification)
    for (name, _), column in zip(kind, columns, strict=True):
        vertex[name] = column
    write_vertices(vertex, [f"EPSG:{EPSG}, metres"], stream)
