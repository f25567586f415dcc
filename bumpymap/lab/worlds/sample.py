"""The sample survey: a synthetic quarry with relief in closed form, flown over by a drone, as files.

The survey has overlapping flight lines of zigzag sweeps, noise, crowns and errors. Points are in the order of flight.
All random numbers are drawn before points are dropped, so the survey of a smaller area contains the same ground points
as that part of the whole survey. ``python -m bumpymap.lab.worlds.sample --out DIR`` writes the files.
"""

import datetime as dt
from argparse import ArgumentDefaultsHelpFormatter, ArgumentParser
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO, Literal, Self, get_args

import laspy
import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from bumpymap.core import BumpymapError, OutputError, atomic, write_vertices
from bumpymap.lab.worlds import quarry
from bumpymap.lab.worlds.quarry import Floats, relief
from bumpytiles import Bounds, Grid

__all__ = ["make_quarry_survey"]

_WANTED = 30


@dataclass(frozen=True, slots=True)
class Tree:
    """One tree; the crown is round seen from above."""

    easting: float
    """m."""
    northing: float
    """m."""
    radius: float
    """Radius of the crown, m."""
    height: float
    """Top above the ground at the trunk, m."""
    is_conifer: bool
    """True: a cone almost down to the ground; False: an ellipsoid on a trunk."""


def plant(
    seed: int, corner: tuple[float, float], may_stand: Callable[[Floats, Floats], NDArray[np.bool_]]
) -> tuple[Tree, ...]:
    """Draw random trees that do not touch each other.

    Parameters
    ----------
    seed : int
        Seed of the site.
    corner : (float, float)
        Easting and northing of the local origin, m.
    may_stand : callable
        Function of local x, y (n,) that is True where a trunk may stand.
    """
    rng = np.random.default_rng((seed, 101))
    candidates = rng.random((400, 2)) * (quarry.EAST_WEST, quarry.NORTH_SOUTH)
    candidates = candidates[may_stand(candidates[:, 0], candidates[:, 1])]
    chosen: list[Tree] = []
    for x, y in candidates.tolist():
        radius = float(rng.uniform(1.3, 2.7))
        tree = Tree(
            corner[0] + x, corner[1] + y, radius, radius * float(rng.uniform(2.3, 3.2)), bool(rng.random() < 0.4)
        )
        clear = all(
            np.hypot(tree.easting - other.easting, tree.northing - other.northing) > radius + other.radius + 0.5
            for other in chosen
        )
        if clear:
            chosen.append(tree)
        if len(chosen) == _WANTED:
            break
    return tuple(chosen)


def crown_over(trees: Iterable[Tree], easting: Floats, northing: Floats) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return top and bottom of the crown above each position.

    Parameters
    ----------
    trees : iterable of Tree
    easting, northing : array (n,) float64
        m.

    Returns
    -------
    top, bottom : array (n,) float64
        m above the ground at the trunk; NaN without a crown.
    tree : array (n,) int64
        Index of the tree; -1 without a crown.
    """
    top, bottom = np.full(easting.shape, np.nan), np.full(easting.shape, np.nan)
    which = np.full(easting.shape, -1, dtype=np.int64)
    for number, tree in enumerate(trees):
        distance = np.hypot(easting - tree.easting, northing - tree.northing) / tree.radius
        under = distance < 1.0
        share = distance[under]
        which[under] = number
        if tree.is_conifer:
            top[under], bottom[under] = tree.height * (1.0 - 0.85 * share), 0.1 * tree.height
        else:
            half = 0.36 * tree.height
            bulge = half * np.sqrt(1.0 - share**2)
            top[under], bottom[under] = tree.height - half + bulge, tree.height - half - bulge
    return top, bottom, which


Zone = Literal[
    "transition",
    "floor",
    "meadow",
    "bank",
    "rubble",
    "stockpile",
    "pond",
    "pad",
    "step",
    "ramp",
    "road",
    "washboard",
    "ruts",
    "outside",
]
ZONES: tuple[Zone, ...] = get_args(Zone)
"""'transition' is the blend between two surfaces; 'outside' is beyond the site."""
EPSG = 32632
"""CRS of the site: WGS 84 / UTM zone 32N, metres. The location is arbitrary."""

_CORNER = (512_340.0, 5_403_210.0)


@dataclass(frozen=True, slots=True)
class QuarrySite:
    """A quarry of 126 x 102 m: road, washboard, ruts, rubble, pad with kerb, ramp, bench wall, meadow, pond, trees.

    The seed changes stones, waves and trees, but not the zones.
    """

    seed: int = 1

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}; it must be zero or more")

    @property
    def bounds(self) -> Bounds:
        """Extent of the site, m; a whole number of 3 m tiles."""
        west, south = _CORNER
        return Bounds(west, south, west + quarry.EAST_WEST, south + quarry.NORTH_SOUTH)

    @property
    def trees(self) -> tuple[Tree, ...]:
        """The trees; their crowns do not belong to the ground."""
        return _trees(self.seed)

    def height(self, easting: Floats, northing: Floats) -> Floats:
        """Height of the bare ground.

        Parameters
        ----------
        easting, northing : array float64
            m; shapes must broadcast.

        Returns
        -------
        array float64
            Upward, m, without trees. Continuous except at the kerb of the pad.
        """
        x, y = _local(easting, northing)
        return relief(self.seed, x.ravel(), y.ravel()).reshape(x.shape)

    def is_water(self, easting: Floats, northing: Floats) -> NDArray[np.bool_]:
        """Return True in the pond, where surveys have no points."""
        return quarry.outside_pond(*_local(easting, northing)) <= 0.0

    def zone_at(self, easting: Floats, northing: Floats) -> NDArray[np.str_]:
        """Return the zone at each position, one of ``ZONES``."""
        x, y = _local(easting, northing)
        return np.array(ZONES)[_zone_code(x, y)]

    def zone_bounds(self, zone: Zone) -> Bounds:
        """Return the bounding box of a zone, in steps of 0.25 m (the two meadows share one)."""
        x, y = np.meshgrid(np.arange(0.125, quarry.EAST_WEST, 0.25), np.arange(0.125, quarry.NORTH_SOUTH, 0.25))
        line, column = np.nonzero(_zone_code(x, y) == ZONES.index(zone))
        if line.size == 0:
            raise ValueError(f"the site has no zone '{zone}'; choose one of {', '.join(ZONES[:-1])}")
        west, south = _CORNER
        return Bounds(
            west + 0.25 * int(column.min()),
            south + 0.25 * int(line.min()),
            west + 0.25 * (int(column.max()) + 1),
            south + 0.25 * (int(line.max()) + 1),
        )

    def tiles_inside(self, zone: Zone, grid: Grid | None = None) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the tiles that lie wholly inside one zone and not under a tree.

        Parameters
        ----------
        zone : Zone
        grid : Grid, optional
            Tiles of 3 m by default.

        Returns
        -------
        col, row : array (k,) int64
            Tested at 31 x 31 positions of each tile, including its edges.
        """
        size = (grid or Grid()).tile_size
        box = self.bounds
        col, row = np.meshgrid(
            np.arange(np.floor(box.west / size), np.ceil(box.east / size)),
            np.arange(np.floor(box.south / size), np.ceil(box.north / size)),
        )
        west, south = col.ravel() * size, row.ravel() * size
        for places in (3, 31):  # coarse test first, which excludes most tiles
            inner = np.linspace(0.0, size, places) * (1.0 - 1e-9)
            easting, northing = np.broadcast_arrays(
                west[:, None, None] + inner[None, None, :], south[:, None, None] + inner[None, :, None]
            )
            within = np.all(_zone_code(*_local(easting, northing)) == ZONES.index(zone), axis=(1, 2))
            west, south = west[within], south[within]
        clear = np.all(crown_over(self.trees, easting[within], northing[within])[2] < 0, axis=(1, 2))
        return np.rint(west[clear] / size).astype(np.int64), np.rint(south[clear] / size).astype(np.int64)


def _local(easting: Floats, northing: Floats) -> tuple[Floats, Floats]:
    """Return coordinates relative to the south-west corner, m, broadcast to a common shape."""
    x, y = np.broadcast_arrays(np.asarray(easting, np.float64), np.asarray(northing, np.float64))
    return x - _CORNER[0], y - _CORNER[1]


@lru_cache(maxsize=8)
def _trees(seed: int) -> tuple[Tree, ...]:
    return plant(seed, _CORNER, lambda x, y: _zone_code(x, y) == ZONES.index("meadow"))


def _zone_code(x: Floats, y: Floats) -> NDArray[np.int64]:
    """Return the index into ``ZONES``; later features cover earlier ones, like their surfaces."""
    code = np.full(x.shape, ZONES.index("floor"), dtype=np.int64)
    north, offset, pad = quarry.along_bank(x, y), quarry.road_offset(x, y), quarry.outside_box(x, y, quarry.PAD)

    def paint(zone: Zone, core: NDArray[np.bool_], around: NDArray[np.bool_] | None = None) -> None:
        if around is not None:
            code[around] = ZONES.index("transition")
        code[core] = ZONES.index(zone)

    paint("meadow", offset < -quarry.ROAD_HALF_WIDTH)
    paint("bank", (north > 0.0) & (north < quarry.BANK_WIDTH), (north > -4.0) & (north < quarry.BANK_WIDTH + 0.5))
    paint("meadow", north >= quarry.BANK_WIDTH + 0.5)
    rubble, heap, pond = quarry.outside_rubble(x, y), quarry.outside_stockpile(x, y), quarry.outside_pond(x, y)
    paint("stockpile", heap <= -0.5, heap < 0.5)
    paint("rubble", rubble <= 0.0, (rubble < 5.0) & (north <= 0.0))
    paint("pond", pond <= 0.0, pond < quarry.BLEND["pond"])
    paint("pad", pad < -quarry.KERB_BAND, pad < quarry.BLEND["pad"])
    paint("step", np.abs(pad) <= quarry.KERB_BAND)
    ramp, spur = quarry.outside_ramp(x, y), quarry.outside_spur(x, y)
    paint("ramp", quarry.outside_box(x, y, quarry.RAMP) <= 0.0, ramp < quarry.BLEND["ramp"])
    graded = (spur <= 0.0) & (y < quarry.RAMP[1] - 3.0)
    paint("road", graded, (spur < quarry.BLEND["spur"]) & (ramp > 0.0))
    core = np.abs(offset) <= quarry.ROAD_HALF_WIDTH
    shoulder = np.abs(offset) < quarry.ROAD_HALF_WIDTH + quarry.BLEND["road"]
    paint("road", core, shoulder)
    sections: tuple[tuple[Zone, tuple[float, float]], ...] = (("washboard", quarry.WASHBOARD), ("ruts", quarry.RUTS))
    for zone, (west, east) in sections:
        paint(zone, core & (x >= west) & (x <= east), core & (x > west - 4.0) & (x < east + 4.0))
    paint("outside", (x < 0.0) | (x >= quarry.EAST_WEST) | (y < 0.0) | (y >= quarry.NORTH_SOUTH))
    return code


SCALE = 0.001
"""Coordinates are whole millimetres."""
NOISE_SIGMA = 0.008
"""Standard deviation of the normal noise of ground heights, m. Horizontal positions have no noise."""
STRAYS = 8
"""Number of unflagged outliers, tens of metres above (5) or below (3) the ground."""
NOISE_POINTS = 60
"""Number of points of class 7, metres off the ground."""
WITHHELD_POINTS = 40
"""Number of points with the withheld flag, decimetres to metres off the ground."""

_LINES = 6
_HALF_SWATH = 13.0
_FLIGHT_HEIGHT = 40.0
_CANOPY_SHARE = 0.7
_PULSE_SECONDS = 1e-5
_FEWEST = 1000
UNASSIGNED, GROUND, TREE, NOISE = 1, 2, 5, 7


@dataclass(frozen=True, slots=True)
class SurveyPoints:
    """A survey, one row per point, in the order of flight."""

    easting: NDArray[np.float64]
    """(n,) m, on the millimetre steps of the file."""
    northing: NDArray[np.float64]
    """(n,) m."""
    upward: NDArray[np.float64]
    """(n,) m."""
    classification: NDArray[np.uint8]
    """(n,) LAS class: 1 unassigned, 2 ground, 5 tree, 7 noise."""
    withheld: NDArray[np.bool_]
    """(n,) True if the point must not be used."""
    is_stray: NDArray[np.bool_]
    """(n,) True if the height is far off although the file does not flag the point."""
    line: NDArray[np.uint16]
    """(n,) flight line, from 1."""
    gps_time: NDArray[np.float64]
    """(n,) s since the first pulse."""

    @property
    def is_true_ground(self) -> NDArray[np.bool_]:
        """(n,) True if the height is that of the relief, within the noise."""
        usable: NDArray[np.bool_] = (self.classification == GROUND) & ~self.withheld & ~self.is_stray
        return usable

    def select(self, keep: NDArray[np.bool_]) -> Self:
        """Return the points for which ``keep`` (n,) is True."""
        return replace(self, **{f.name: getattr(self, f.name)[keep] for f in fields(self)})


def sample_survey(site: QuarrySite, density: float = 100.0, area: Bounds | None = None) -> SurveyPoints:
    """Simulate a survey flight over the site.

    Parameters
    ----------
    site : QuarrySite
    density : float
        Mean points per square metre of the whole site; it varies from place to place by a factor of about three.
    area : Bounds, optional
        Keep only this part, m.

    Returns
    -------
    SurveyPoints

    Raises
    ------
    ValueError
        Fewer than 1000 points would be left.
    """
    if not (np.isfinite(density) and density > 0.0):
        raise ValueError(f"density is {density}; it must be a positive number of points per square metre")
    lines = [_fly_line(site, number, density, area or site.bounds) for number in range(_LINES)]
    points = SurveyPoints(*(np.concatenate([getattr(line, f.name) for line in lines]) for f in fields(SurveyPoints)))
    if points.easting.size < _FEWEST:
        raise ValueError(
            f"{points.easting.size} points at {density:g} per square metre; a survey needs {_FEWEST}: "
            "raise the density or widen the area"
        )
    return _add_errors(points, site.seed)


def _fly_line(site: QuarrySite, number: int, density: float, area: Bounds) -> SurveyPoints:
    """Return the points of one flight line inside the area."""
    rng = np.random.default_rng((site.seed, 200 + number))
    easting, northing, pulse = _sweep(rng, site.bounds, number, density)
    ground_noise = NOISE_SIGMA * rng.standard_normal(easting.size)
    crown_draw, crown_depth = rng.random(easting.size), rng.exponential(0.5, easting.size)
    easting, northing = _quantised(easting, site.bounds.west), _quantised(northing, site.bounds.south)
    keep = (easting >= area.west) & (easting < area.east) & (northing >= area.south) & (northing < area.north)
    keep &= ~site.is_water(easting, northing) & (rng.random(easting.size) > 0.01)
    easting, northing = easting[keep], northing[keep]
    canopy, is_tree = _canopy(site, easting, northing, crown_draw[keep], crown_depth[keep])
    upward = np.where(is_tree, canopy, site.height(easting, northing) + ground_noise[keep])
    none = np.zeros(easting.size, dtype=np.bool_)
    return SurveyPoints(
        easting=easting,
        northing=northing,
        upward=_quantised(upward, 0.0),
        classification=np.where(is_tree, TREE, GROUND).astype(np.uint8),
        withheld=none,
        is_stray=none,
        line=np.full(easting.size, number + 1, dtype=np.uint16),
        gps_time=(60.0 * number + _PULSE_SECONDS * pulse[keep]).astype(np.float64),
    )


def _sweep(
    rng: np.random.Generator, box: Bounds, number: int, density: float
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return the positions at which the pulses of a line hit the ground inside the site, in the order of the pulses.

    The drone's speed varies by a quarter, it rolls a little, and its start and end points vary; odd lines fly west.
    """
    width, pitch = box.east - box.west, (box.north - box.south) / _LINES
    swept = 2.0 * _HALF_SWATH * _LINES - 2.0 * (_HALF_SWATH - pitch / 2.0)
    spacing = 1.0 / np.sqrt(density * (box.north - box.south) / swept)
    sweeps, pulses = int(width / spacing), int(2.0 * _HALF_SWATH / spacing)
    pulse = np.arange(sweeps * pulses)
    sweep, within = np.divmod(pulse, pulses)
    along = pulse / pulses * spacing
    along = along + 1.5 * np.sin(2.0 * np.pi * (along / 40.0 + rng.random()))
    angle = np.arctan(_HALF_SWATH / _FLIGHT_HEIGHT) * (2.0 * (within + 0.5) / pulses - 1.0) * (1 - 2 * (sweep % 2))
    roll = np.radians(0.6) * np.sin(2.0 * np.pi * (along / 23.0 + rng.random()))
    x = along + 0.25 * spacing * rng.standard_normal(pulse.size)
    y = pitch * (number + 0.5) + _FLIGHT_HEIGHT * np.tan(angle + roll)
    y += 0.25 * spacing * rng.standard_normal(pulse.size)
    start, end = 1.5 * rng.random(2) * (1.0, -1.0) + (0.0, width)
    inside = (x >= start) & (x < end) & (y >= 0.0) & (y < box.north - box.south)
    if number % 2:
        x = width - x
    return box.west + x[inside], box.south + y[inside], pulse[inside]


def _canopy(
    site: QuarrySite, easting: Floats, northing: Floats, draw: Floats, depth: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return heights of crown points (n,) m, and True (n,) for pulses that stop in a crown."""
    top, bottom, tree = crown_over(site.trees, easting, northing)
    is_tree = (tree >= 0) & (draw < _CANOPY_SHARE)
    trunk = np.array([(t.easting, t.northing) for t in site.trees])
    foot = site.height(trunk[:, 0], trunk[:, 1])
    return foot[tree] + np.maximum(top - depth, bottom), is_tree


def _add_errors(points: SurveyPoints, seed: int) -> SurveyPoints:
    """Move some ground points off the ground: unflagged outliers, class 7, withheld."""
    rng = np.random.default_rng((seed, 300))
    ground = np.flatnonzero(points.classification == GROUND)
    chosen = rng.choice(ground, STRAYS + NOISE_POINTS + WITHHELD_POINTS, replace=False)
    stray, noise, withheld = np.split(chosen, (STRAYS, STRAYS + NOISE_POINTS))
    upward, classification = points.upward.copy(), points.classification.copy()
    is_stray, is_withheld = points.is_stray.copy(), points.withheld.copy()
    upward[stray[:5]] += rng.uniform(18.0, 60.0, 5)
    upward[stray[5:]] -= rng.uniform(12.0, 40.0, STRAYS - 5)
    classification[stray[::2]] = UNASSIGNED
    is_stray[stray] = True
    upward[noise] += rng.uniform(3.0, 25.0, noise.size) * rng.choice((-1.0, 1.0), noise.size)
    classification[noise] = NOISE
    upward[withheld] += rng.uniform(0.3, 3.0, withheld.size) * rng.choice((-1.0, 1.0), withheld.size)
    is_withheld[withheld] = True
    return replace(
        points,
        upward=_quantised(upward, 0.0),
        classification=classification,
        is_stray=is_stray,
        withheld=is_withheld,
    )


def _quantised(value: Floats, origin: float) -> Floats:
    """Round to the file's resolution and return the exact float that a reader of the file computes."""
    return np.rint((value - origin) / SCALE) * SCALE + origin


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


def main(arguments: Sequence[str] | None = None) -> None:
    """Write quarry.laz and quarry_part.ply; ``arguments`` default to those of the process."""
    parser = ArgumentParser(
        "python -m bumpymap.lab.worlds.sample",
        description="Make a survey of a synthetic quarry: quarry.laz and quarry_part.ply.",
        formatter_class=ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write to")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="0 or more; determines the site")
    given = parser.parse_args(arguments)
    if given.seed < 0:
        parser.error(f"--seed is {given.seed}; it must be 0 or more")
    try:
        make_quarry_survey(given.out, given.seed)
    except BumpymapError as error:
        parser.exit(error.exit_code, f"Error: {error}\n")


if __name__ == "__main__":
    main()
