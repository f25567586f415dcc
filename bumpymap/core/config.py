"""Settings of a map, a comparison, a check, an export, the polar grid and robot of scans: declared once, checked."""

import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.core.settings import NameOrFile, Setting, check_settings

if TYPE_CHECKING:
    from bumpytiles import Grid

Ground = Literal["auto", "all", "class", "csf"]
Compat = Literal["none", "paper"]
Align = Literal["off", "report"]
Rating = Literal["ride", "table"]
LengthUnit = Literal["m", "ft", "us-ft"]
GROUND_CLASSES = (2, 11, 17)
"""LAS classes that are ground: ground, road surface, bridge deck."""
DECK_CLASS = 17
"""The one that hides the ground beneath."""
ScanMethod = Literal["filter", "learned"]

_MOST_SECTORS = 32_767
"""Cells of a polar grid: sectors and rings are counted in 16 bits, and each takes some kilobytes."""
_MOST_GRID_CELLS = 4_000_000
"""Cells of a grid around a sensor at most: 2,000 x 2,000."""
_CLASSIFIED_SHARE = 0.5
"""``ground = "auto"`` uses only ground points if more than this share of the tiles has such points, but for a part that
was never classified."""


Clash: TypeAlias = tuple[str, str, str]
"""Two settings that exclude each other, and why. A flag that is False and the value ``none`` count as not set."""

VEHICLE_OR_CALIBRATION: Clash = ("calibration", "vehicle", "a calibration is that of one vehicle")
OF_CRS: tuple[Clash, ...] = (
    *((name, "local", "coordinates in a CRS are not local") for name in ("crs", "force_crs")),
    ("crs", "force_crs", "the one is for surveys that have no CRS, the other for all"),
)
CLASHES: tuple[Clash, ...] = (
    VEHICLE_OR_CALIBRATION,
    ("compat", "rating", "the paper has a rating of its own"),
    *OF_CRS,
)
"""Settings of a map run that exclude each other."""


@dataclass(frozen=True, slots=True)
class FeatureSettings:
    """How tiles are measured, and when a heightmap cannot be rated.

    With ``rating = "ride"`` tiles that have too few points or too many holes for the first three are rated from their
    points where these carry it, by a rule that has no settings (``docs/pages/measuring.md``).
    """

    min_points: Annotated[int, Setting(low=3)] = 30
    """The heightmap of a tile with fewer points is not rated, reason 2. A larger number holds for thin tiles too."""
    min_coverage: Annotated[float, Setting(low=0.0, high=1.0)] = 0.25
    """One with a smaller share of pixels that hold a point is not rated, reason 3."""
    max_hole: Annotated[float, Setting(low=0.0, high=1e6, unit="m")] = 1.0
    """One with a pixel farther than this from every pixel that holds a point is not rated, reason 3, m."""
    ransac_threshold: Annotated[float, Setting(low=1e-6, high=1e6, unit="m")] = 0.1
    """Points within this distance of a plane are its inliers, m."""
    stray_gap: Annotated[float, Setting(low=0.0, high=1e6, unit="m")] = 0.5
    """A stray point is separated from all others by more than this (and by more than their spread), m."""
    stray_points: Annotated[int, Setting(low=0)] = 3
    """Number of stray points searched for above, and below, the others."""
    stray_share: Annotated[float, Setting(low=0.0, high=1.0)] = 0.01
    """A tile with a larger share of stray points is unknown, reason 5: its relief cannot be separated from noise."""

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class CsfSettings:
    """Settings of the cloth simulation filter that finds ground points (``ground = "csf"``)."""

    cloth_resolution: Annotated[float, Setting(low=0.05, high=100.0, unit="m")] = 0.5
    """Mesh size of the cloth, m."""
    class_threshold: Annotated[float, Setting(low=0.01, high=10.0, unit="m")] = 0.5
    """Points within this distance of the cloth are ground, m."""
    rigidness: Annotated[int, Setting(low=1, high=3)] = 3
    """Stiffness of the cloth: 1 follows steep slopes, 3 bridges wide objects."""
    slope_smooth: bool = True
    """Pull the cloth down at the foot of steep slopes, where it hangs in the air."""

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class PageSettings:
    """Header of a page, beside the survey's name and date."""

    title: str | None = None
    """Heading of the page; None: the name of the survey."""
    client: str | None = None
    """For whom the survey was made."""
    operator: str | None = None
    """Who made it."""
    note: str | None = None
    """A sentence below the header."""
    logo: Path | None = None
    """A PNG or JPEG of at most 5 MB and 50 million pixels, which the page holds; a link is not followed."""


@dataclass(frozen=True, slots=True)
class ReportSettings:
    """Settings of `bumpymap report`."""

    page: PageSettings = field(default_factory=PageSettings)


INCLUDED_PIXELS: Mapping[float, int] = {3.0: 15, 5.0: 25, 6.0: 30}
"""Tile sizes [m] for which calibrations are included, and pixels along such a tile: of 0.2 m."""


def with_pixels(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings of a map or calibration with the number of pixels that suits their tiles, if they give none."""
    return {"pixels": INCLUDED_PIXELS.get(settings.get("tile_size", 3.0), 15)} | dict(settings)


@dataclass(frozen=True, slots=True)
class MapConfig:
    """All settings of a ``map`` run."""

    surveys: tuple[Path, ...]
    """Files and folders."""
    out: Annotated[Path, Setting("Folder for the layers", "DIR", group="Output")]
    tile_size: Annotated[float, Setting("Side of a tile, in metres", "M", 0.05, 1000.0, "m", group="Ground")] = 3.0
    pixels: Annotated[
        int,
        Setting(
            "Heightmap pixels along a side of a tile", "N", 3, 255, default="15; 25, 30 for tiles of 5, 6 m", rare=True
        ),
    ] = 15
    ground: Annotated[Ground, Setting("Points to use: auto, all, class or csf", "KIND", group="Ground")] = "auto"
    """Points that are measured: ``all``; those whose ``class`` is ground; ``auto``: these if most tiles have such
    points, but all in a part that was never classified, else all; or those that a cloth simulation filter finds
    (``csf``)."""
    ground_classes: Annotated[
        tuple[int, ...], Setting("Classes of ground: 2,8,11,40", "LIST", 1, 255, default="2,11,17", group="Ground")
    ] = GROUND_CLASSES
    """LAS classes whose points are ground with ``ground = "auto"`` or ``"class"``: ground, road surface, bridge deck.
    Points of class 17, a bridge deck, hide the ground beneath them."""
    align: Annotated[Align, Setting("Height steps of flight lines: off, report", "WHAT", group="Ground")] = "report"
    """Height steps between flight lines: ``report`` measures them, ``off`` does not."""
    rating: Annotated[Rating, Setting("How the ride cost is predicted", rare=True)] = "ride"
    """``ride`` rolls the vehicle over each tile; ``table`` looks up its texture and z range, as the paper does."""
    compat: Annotated[Compat, Setting("paper: use the rules of the BumpyPatch paper", default="", rare=True)] = "none"
    vehicle: Annotated[NameOrFile, Setting("An included vehicle, or a TOML file", "NAME|FILE", group="Vehicle")] = (
        "warthog"
    )
    """A vehicle that ships with bumpymap, or the TOML file of one, with its calibration file in the same folder."""
    calibration: Annotated[Path | None, Setting("Calibration file of your own vehicle", "FILE", group="Vehicle")] = None
    """A calibration file, used instead of ``vehicle``."""
    speed: Annotated[
        float | None, Setting("Rated speed, m/s", "SPEED", 0.01, 100.0, "m/s", default="the vehicle's", group="Vehicle")
    ] = None
    """Speed that the ride is rated at, m/s; None: that of the vehicle's profile."""
    model: Annotated[Path | None, Setting("ONNX file of your own texture network", "FILE", rare=True)] = None
    """The ONNX file of a texture network, used instead of the one that ships with bumpymap."""
    crs: Annotated[str | None, Setting("CRS of surveys that have none: EPSG:32614", "CRS", group="Input")] = None
    force_crs: Annotated[
        str | None, Setting("CRS of all surveys, whatever they state", "CRS", group="Input", rare=True)
    ] = None
    xy_unit: Annotated[
        LengthUnit | None,
        Setting("Unit of surveys without a CRS: m, ft or us-ft", "UNIT", default="metre is assumed", group="Input"),
    ] = None
    """Unit of easting and northing, and of heights without `z_unit`, if no CRS states it."""
    z_unit: Annotated[
        LengthUnit | None, Setting("Unit of heights: m, ft or us-ft", "UNIT", default="of the CRS", group="Input")
    ] = None
    """Unit of heights, if the survey's CRS does not state it or is wrong."""
    dtm: Annotated[bool, Setting("Rasters of heights are of the ground alone (DTM)", group="Input")] = False
    """A pixel of a raster of heights is ground (DTM), and not the highest surface there (DSM)."""
    photo: Annotated[Path | None, Setting("Orthophoto (GeoTIFF) for photo.tif", "FILE", group="Input")] = None
    """An orthophoto, for photo.tif, instead of the colours of points."""
    local: Annotated[bool, Setting("Keep the coordinates of surveys without a CRS", group="Input")] = False
    trust_points: Annotated[
        bool, Setting("Accept files whose points contradict the extent in the header", rare=True)
    ] = False
    skip_bad: Annotated[bool, Setting("Skip files that cannot be read (exit code 4)", group="Input")] = False
    max_unknown: Annotated[
        float | None, Setting("Fail (exit code 4) if more tiles are unknown: 50% or 0.5", "SHARE", 0.0, 1.0, rare=True)
    ] = None
    """Largest share of unknown tiles, 0..1, among those with points, with which a run succeeds. The layers are written
    anyway."""
    overwrite: Annotated[bool, Setting("Replace the layers of an earlier run", group="Output")] = False
    threads: Annotated[int, Setting("Number of threads", "N", 1, default="all cores")] = field(
        default_factory=lambda: os.cpu_count() or 1
    )
    """Number of threads on this machine."""
    memory: Annotated[
        str,
        Setting("Memory beyond the interpreter's", "SIZE", default="a quarter of what is free"),
    ] = "auto"
    """Memory to use beyond that of the interpreter and its libraries, such as ``1GB``; for each worker of a
    ``scheduler``. ``auto``: a quarter of the memory that is free when the run starts, at least 512 MB and at most 8 GB,
    or 1 GB for each worker."""
    scratch: Annotated[
        Path | None, Setting("Folder for points that exceed the memory limit", "DIR", default="in `out`", rare=True)
    ] = None
    """Folder for temporary files of points that do not fit in memory; None: in the output folder."""
    scheduler: Annotated[str | None, Setting("Run on the workers of this dask scheduler", "ADDRESS", rare=True)] = None
    """Address of a dask.distributed scheduler whose workers are used; None: everything runs in this process."""
    provider: Annotated[str, Setting("Who made the survey, in catalogues and on the page", rare=True)] = ""
    license: Annotated[str, Setting("Licence of the layers, for catalogues: CC-BY-4.0", rare=True)] = ""
    """SPDX identifier, or ``other``; empty: none is stated."""
    features: FeatureSettings = field(default_factory=FeatureSettings)
    csf: CsfSettings = field(default_factory=CsfSettings)
    page: PageSettings = field(default_factory=PageSettings)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.speed is not None and not self.by_ride:
            name, value = ("rating", self.rating) if self.compat == "none" else ("compat", self.compat)
            raise UsageError(
                f"`{name}='{value}'` knows no speed: only the ride model does. Leave out `speed`, or `{name}`"
            )
        if not re.fullmatch(r"[\w.+-]*", self.license, re.ASCII):
            raise UsageError(f"`license` is {self.license!r}; give an SPDX identifier such as CC-BY-4.0, or 'other'")

    @property
    def grid(self) -> "Grid":
        """Tiles and their pixels."""
        from bumpytiles import Grid  # NumPy, which the options of the command line need not wait for

        return Grid(self.tile_size, self.pixels)

    @property
    def by_ride(self) -> bool:
        """True if tiles are rated by the ride model: then those with few points are rated from their points."""
        return self.rating == "ride" and self.compat == "none"


@dataclass(frozen=True, slots=True)
class PolarSettings:
    """The concentric-zone polar grid.

    From 4 m on the defaults are the paper's grid. The zone before it is for robots whose sensor is low: half of their
    points lie there.
    """

    zone_starts_m: Annotated[
        tuple[float, ...],
        Setting(
            "Borders of the zones, m", "LIST", 0.0, unit="m", default="1,4,12,28,60,100", option="zones", rare=True
        ),
    ] = (1.0, 4.0, 12.0, 28.0, 60.0)
    """Inner radius of each zone, horizontal distance from the sensor, m."""
    end_m: float = 100.0
    """Outer radius of the last zone, m."""
    sectors: Annotated[tuple[int, ...], Setting("Sectors around each zone", "LIST", 3, rare=True)] = (
        16,
        24,
        32,
        48,
        32,
    )
    rings: Annotated[tuple[int, ...], Setting("Rings of each zone", "LIST", 1, rare=True)] = (2, 4, 4, 4, 2)
    """Rings of each zone, of equal width."""
    least_points: Annotated[int, Setting(low=3)] = 30
    """A sector is judged if it has more points than this, and measured if it has ground."""
    pixels: Annotated[int, Setting(low=3, high=64)] = 15
    """Rows and columns of a sector's heightmap."""
    least_normal_z: Annotated[float, Setting(low=0.0, high=1.0)] = math.cos(math.radians(45.0))
    """A sector is traversable if the n_z of its plane is at least this. The default, 45 degrees, is the limit at which
    published ground segmentation on the same grid treats a sector as a wall."""
    overhead_m: float = 2.0
    """A sector whose plane passes more than this above the sensor is seen from below: a ceiling or a canopy, not
    ground. The margin allows for frames whose origin is at the robot's base."""
    belly_m: Annotated[float, Setting(low=0.0, unit="m", exclusive=True)] = 0.25
    """Height above the ground from which a point is an obstacle: the clearance of the vehicle's belly."""
    height_m: Annotated[float, Setting(low=0.0, unit="m", exclusive=True)] = 1.38
    """Height of the vehicle: what is higher above the ground is overhead."""

    def __post_init__(self) -> None:
        check_settings(self)
        edges = (*self.zone_starts_m, self.end_m)
        if not len(self.zone_starts_m) == len(self.sectors) == len(self.rings) > 0:
            raise UsageError(
                "`zone_starts_m`, `sectors` and `rings` must be for equally many zones; they are for "
                f"{len(self.zone_starts_m)} (ending at {self.end_m:g} m), {len(self.sectors)} and {len(self.rings)}. "
                "Give all three"
            )
        if not (edges[-1] < math.inf and all(inner < outer for inner, outer in pairwise(edges))):
            raise UsageError(f"`zone_starts_m`: zones must grow outwards; {edges} m were given")
        cells = sum(around * outwards for around, outwards in zip(self.sectors, self.rings, strict=True))
        if cells > _MOST_SECTORS:
            raise UsageError(
                f"{self.sectors} sectors in {self.rings} rings are {cells:,} cells; a polar grid has at most "
                f"{_MOST_SECTORS:,}. Give fewer `sectors` or `rings`"
            )
        if math.isnan(self.overhead_m) or self.height_m <= self.belly_m:
            raise UsageError(
                f"overhead_m is {self.overhead_m}, belly_m {self.belly_m}, height_m {self.height_m}; the first must be "
                "a number, and height_m more than belly_m"
            )


@dataclass(frozen=True, slots=True)
class Robot:
    """The region, in the sensor frame, in which returns are from the robot that carries the sensor."""

    radius_m: Annotated[
        float,
        Setting(
            "Exclude returns nearer than this, as on the robot", "M", 0.0, unit="m", option="robot-radius", rare=True
        ),
    ] = 0.5
    """Returns closer than this, horizontally, are on the robot; 0: none are. The default covers the robot's deck: from
    a roof or a mast, no beam hits the ground as close."""
    box_m: tuple[float, float, float, float] | None = None
    """Rear, front, right and left end (x from, x to, y from, y to) of a longer robot, m; at any height."""

    def __post_init__(self) -> None:
        check_settings(self)
        rear, front, right, left = self.box_m or (0.0, 1.0, 0.0, 1.0)
        if not (rear < front and right < left):
            raise UsageError(
                f"box_m is {self.box_m}; the box of the robot goes from rear to front and from right to left, in "
                "metres: x from, x to, y from, y to"
            )


@dataclass(frozen=True, slots=True)
class GridSettings:
    """Size of the grids of scans."""

    resolution_m: Annotated[float, Setting(low=0.0, unit="m", exclusive=True)] = 0.25
    """Side of a cell."""
    reach_m: Annotated[float, Setting(low=0.0, unit="m", exclusive=True)] = 30.0
    """Distance from the sensor to each side of the grid."""

    def __post_init__(self) -> None:
        check_settings(self)
        if self.resolution_m > self.reach_m or (2.0 * self.reach_m / self.resolution_m) ** 2 > _MOST_GRID_CELLS:
            raise UsageError(
                f"a grid reaches {self.reach_m} m with cells of {self.resolution_m} m; it must reach one cell or more, "
                f"and there are at most {_MOST_GRID_CELLS:,} cells"
            )


def refuse_clashes(settings: Mapping[str, Any], clashes: Sequence[Clash], spelled: Callable[[str], str] = str) -> None:
    """Raise UsageError if settings exclude each other; ``spelled`` returns a setting's name for the message."""
    for first, second, why in clashes:
        if _both_set(settings, first, second):
            names = f"{spelled(first)} and {spelled(second)}"
            raise UsageError(f"{names} contradict each other: {why}. Leave one of them out")


def _both_set(settings: Mapping[str, Any], *names: str) -> bool:
    return all(settings.get(name, False) not in {False, "none"} for name in names)


def override_settings(lower: Mapping[str, Any], upper: Mapping[str, Any], clashes: Sequence[Clash]) -> dict[str, Any]:
    """Return settings of two sources; ``upper`` also overrides the settings of ``lower`` that contradict it."""
    both = {**lower, **upper}
    lost = {name for *pair, _ in clashes if _both_set(both, *pair) for name in pair if name not in upper}
    return {name: value for name, value in both.items() if name not in lost}


def decide_ground(ground: Ground, tiles: int, flagged: float) -> bool:
    """Return whether only ground points are measured.

    ``tiles``: tiles of the survey that hold points, without those of a part that was never classified; ``flagged``:
    those of them that hold ground points.
    """
    if ground == "all":
        return False
    if ground == "class" and not flagged:
        raise BadInputError(
            "`ground='class'`: no point of the survey has a class of `ground_classes` (2, 11, 17 by default). "
            "Use `ground='all'`"
        )
    return ground in {"class", "csf"} or flagged > _CLASSIFIED_SHARE * tiles


MOST_COST = 1e9
"""Weights beyond all ground, with which costs can still be added up."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DirectionSettings:
    """Settings of what a metre costs by the direction in which it is driven."""

    climb: Annotated[float, Setting("Detour that a metre of climb is worth", "M", 0.0, MOST_COST, "m", rare=True)] = 0.0
    descent: Annotated[
        float, Setting("Detour that a metre of descent is worth", "M", 0.0, MOST_COST, "m", rare=True)
    ] = 0.0
    side_slope: Annotated[
        float, Setting("Detour that a metre across a slope of 100 % is worth", "M", 0.0, MOST_COST, "m", rare=True)
    ] = 0.0
    side_limit: Annotated[
        float | None,
        Setting("Steepest slope that is driven across", "DEG", 0.0, 90.0, "degrees", exclusive=True, rare=True),
    ] = None

    @property
    def knows_slope(self) -> bool:
        """True if the cost of a metre depends on the slope in its direction."""
        return self.side_limit is not None or max(self.climb, self.descent, self.side_slope) > 0.0

    @property
    def same_back(self) -> bool:
        """True if a way costs the same there and back."""
        return self.climb == self.descent

    @property
    def steepest(self) -> float:
        """Tangent of ``side_limit``; infinite if there is none."""
        return math.inf if self.side_limit is None else math.tan(math.radians(self.side_limit))


@dataclass(frozen=True, slots=True)
class DiffConfig:
    """All settings of a ``diff`` run."""

    before: Path
    """Layers of the earlier survey."""
    after: Path
    """Layers of the later one."""
    out: Annotated[Path | None, Setting("Folder for the files: raster, places, page", "DIR", group="Output")] = None
    """Folder for the files; None: only the summary."""
    fdr: Annotated[
        float, Setting("Share of changed tiles found by mistake", "SHARE", 0.0, 1.0, exclusive=True, rare=True)
    ] = 0.05
    min_tiles: Annotated[int, Setting("Fewest connected tiles of a change", "N", 1, rare=True)] = 2
    """Fewest connected tiles of a change; smaller ones are left out."""
    offset: Annotated[
        float | None, Setting("Height to take off AFTER", "M", unit="m", default="as measured", rare=True)
    ] = None
    """Height that is taken off the later survey, m; None: the median difference, as measured, and a tilt before it."""
    register: Annotated[bool, Setting("Find a shift and a tilt of AFTER and take them off", rare=True)] = True
    overwrite: Annotated[bool, Setting("Replace the files of an earlier run", group="Output")] = False

    def __post_init__(self) -> None:
        check_settings(self)


LEAST_WINDOW_M = 5.0
"""Shortest stretch that gets a C_r of its own, m (chosen: of less it is chance)."""


@dataclass(frozen=True, slots=True)
class CheckConfig:
    """All settings of a ``check`` run."""

    drives: Annotated[
        tuple[str, ...],
        Setting("Log: CSV, bag, ULog; files of one drive by commas", "LOG", option="drive", group="Input"),
    ]
    layers: Path | None = None
    """Layers of the map; None: the drives are measured alone."""
    out: Annotated[Path | None, Setting("Folder for the files: page, tables, GIS layers", "DIR", group="Output")] = None
    """Folder for the files; None: only the summary."""
    columns: Mapping[str, str] | None = None
    """Quantity -> column or topic that holds it; None: by their names."""
    band_hz: Annotated[
        float, Setting("Rates are low-passed at this frequency", "HZ", 1.0, unit="Hz", option="band", rare=True)
    ] = 10.0
    window_m: Annotated[
        float,
        Setting(
            "Length of a stretch, at least 5",
            "M",
            LEAST_WINDOW_M,
            unit="m",
            why=", so that the C_r of a stretch is more than chance",
            option="window",
            rare=True,
        ),
    ] = 10.0
    calibration: Annotated[
        Path | None, Setting("That of the map, if it is not included; what --refit moves", "FILE", group="Vehicle")
    ] = None
    """The calibration that the map was made with; None: an included one."""
    overwrite: Annotated[bool, Setting("Replace the files of an earlier check", group="Output")] = False

    def __post_init__(self) -> None:
        check_settings(self)
        if not self.drives:
            raise UsageError("no drive is given. Give the log of a drive with `drives`, such as a CSV file or a bag")
        twice = [drive for number, drive in enumerate(self.drives) if drive in self.drives[:number]]
        if twice:
            raise UsageError(f"the drive {twice[0]} is given twice, and would count twice. Give each once")


ExportFormat = Literal["nav2", "gridmap", "plan", "cost"]
"""Maps and masks for Nav2; a grid_map message; a mission for QGroundControl; cost on pixels."""
ExportResolution = Literal["pixel", "tile"]
"""One cell a pixel of the heightmap, or one a tile, which is closed if anything stands in it."""


@dataclass(frozen=True, slots=True)
class ExportSettings:
    """Settings of an export."""

    to: Annotated[ExportFormat, Setting("Format; see above", "FORMAT", default="", group="Output")] = "nav2"
    around: tuple[float, float] | None = None
    """Easting and northing on the grid, m: export the tiles within ``radius`` to each side of it; else all."""
    radius: Annotated[
        float, Setting("How far around, to each side, m", "M", 0.0, unit="m", exclusive=True, group="Input")
    ] = 100.0
    datum: tuple[float, float] | None = None
    """Easting and northing of the local frame's origin, m; else a corner of a tile near the middle."""
    resolution: Annotated[
        ExportResolution, Setting("nav2, gridmap: a cell is a pixel or a tile", "SIZE", group="Output")
    ] = "pixel"
    max_cost: Annotated[
        float | None,
        Setting(
            "nav2: cost per metre of the highest value",
            "COST",
            1.0,
            exclusive=True,
            default="very rough ground",
            rare=True,
        ),
    ] = None
    """nav2: cost per metre of the highest value; else that of very rough ground for the vehicle."""
    route: Annotated[
        Path | None, Setting("plan: folder or GeoJSON of a route", "PATH", default="LAYERS", group="Input")
    ] = None
    """plan: folder that ``bumpymap route`` wrote, or GeoJSON file of a route; else the first folder of the map."""
    through_obstacles: Annotated[bool, Setting("plan: take a route that touches obstacles too", group="Input")] = False

    def __post_init__(self) -> None:
        check_settings(self)
        for name, place in (("around", self.around), ("datum", self.datum)):
            if place is not None and not all(map(math.isfinite, place)):
                raise UsageError(f"`{name}` is {place}; it must be two numbers, easting and northing in metres")
