"""Settings of a map run: frozen dataclasses with defaults, validated when they are created."""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, get_args

from bumpymap.core.errors import BadInputError, UsageError

__all__ = [
    "CLASHES",
    "OF_CRS",
    "RESUME_OR_OVERWRITE",
    "VEHICLE_OR_CALIBRATION",
    "Align",
    "Clash",
    "Compat",
    "CsfSettings",
    "FeatureSettings",
    "Ground",
    "MapConfig",
    "NameOrFile",
    "Rating",
    "ZUnit",
    "decide_ground",
    "names_a_file",
    "override_settings",
    "refuse_clashes",
]

Ground = Literal["auto", "all", "class", "csf"]
Compat = Literal["none", "paper"]
Align = Literal["off", "report", "on"]
Rating = Literal["ride", "table"]
ZUnit = Literal["m", "ft", "us-ft"]
NameOrFile = Annotated[str, "a name, or the path of a file"]
"""A relative path in a settings file starts at the folder of that file."""

RESUME_OR_OVERWRITE = (
    "`resume=True` continues an interrupted run, `overwrite=True` starts again: give one of them. A run that was "
    "started with `overwrite=True` is resumed with just `resume=True`"
)
_MOST_SPEEDS = 16
_CLASSIFIED_SHARE = 0.5
"""``ground = "auto"`` uses only points of class 2 if more than this share of the tiles has such points."""


@dataclass(frozen=True, slots=True)
class Clash:
    """Two settings that exclude each other, and why."""

    first: str
    second: str
    why: str

    def applies(self, settings: Mapping[str, Any]) -> bool:
        """Return whether both are set; a flag that is False and the value ``none`` count as not set."""
        return all(name in settings and settings[name] not in {False, "none"} for name in (self.first, self.second))


VEHICLE_OR_CALIBRATION = Clash("calibration", "vehicle", "a calibration is that of one vehicle")
OF_CRS = (
    *(Clash(name, "local", "coordinates in a CRS are not local") for name in ("crs", "force_crs")),
    Clash("crs", "force_crs", "the one is for surveys that have no CRS, the other for all"),
)
CLASHES = (VEHICLE_OR_CALIBRATION, Clash("compat", "rating", "the paper has a rating of its own"), *OF_CRS)
"""Settings of a map run that exclude each other."""


@dataclass(frozen=True, slots=True)
class NumberRange:
    """The numbers that a setting can be, given in the ``Annotated`` type of its field."""

    low: float
    high: float = math.inf
    unit: str = ""
    whole: bool = False
    """True: only whole numbers are allowed."""

    @property
    def allowed(self) -> str:
        """Description of the allowed numbers; continues *it must be*."""
        kind = "a whole number" if self.whole else "a number"
        if self.high == math.inf:
            return f"{kind}, at least {self.low:g}"
        return f"{kind} from {self.low:g} to {self.high:g} {self.unit}".rstrip()

    def fault(self, value: Any) -> str:
        """Return what is wrong with a value; empty if nothing is."""
        is_number = isinstance(value, int if self.whole else int | float) and not isinstance(value, bool)
        return "" if is_number and self.low <= value <= self.high else f"it must be {self.allowed}"


_SPEED = NumberRange(0.01, 100.0, "m/s")


@dataclass(frozen=True, slots=True)
class FeatureSettings:
    """How tiles are measured, and when a heightmap cannot be rated.

    With ``rating = "ride"`` tiles that have too few points or too many holes for the first three are rated from their
    points where these carry it, by a rule that has no settings (``docs/pages/thin-surveys.md``).
    """

    min_points: Annotated[int, NumberRange(3, whole=True)] = 30
    """The heightmap of a tile with fewer points is not rated, reason 2. A larger number holds for thin tiles too."""
    min_coverage: Annotated[float, NumberRange(0.0, 1.0)] = 0.25
    """One with a smaller share of pixels that hold a point is not rated, reason 3."""
    max_hole: Annotated[float, NumberRange(0.0, 1e6, "m")] = 1.0
    """One with a pixel farther than this from every pixel that holds a point is not rated, reason 3, m."""
    ransac_threshold: Annotated[float, NumberRange(1e-6, 1e6, "m")] = 0.1
    """Points within this distance of a plane are its inliers, m."""
    stray_gap: Annotated[float, NumberRange(0.0, 1e6, "m")] = 0.5
    """A stray point is separated from all others by more than this (and by more than their spread), m."""
    stray_points: Annotated[int, NumberRange(0, whole=True)] = 3
    """Number of stray points searched for above, and below, the others."""
    stray_share: Annotated[float, NumberRange(0.0, 1.0)] = 0.01
    """A tile with a larger share of stray points is unknown, reason 5: its relief cannot be separated from noise."""

    def __post_init__(self) -> None:
        _check_ranges(self)


@dataclass(frozen=True, slots=True)
class CsfSettings:
    """Settings of the cloth simulation filter that finds ground points (``ground = "csf"``)."""

    cloth_resolution: Annotated[float, NumberRange(0.05, 100.0, "m")] = 0.5
    """Mesh size of the cloth, m."""
    class_threshold: Annotated[float, NumberRange(0.01, 10.0, "m")] = 0.5
    """Points within this distance of the cloth are ground, m."""
    rigidness: Annotated[int, NumberRange(1, 3, whole=True)] = 3
    """Stiffness of the cloth: 1 follows steep slopes, 3 bridges wide objects."""
    slope_smooth: bool = True
    """Pull the cloth down at the foot of steep slopes, where it hangs in the air."""

    def __post_init__(self) -> None:
        _check_ranges(self)


@dataclass(frozen=True, slots=True)
class MapConfig:
    """All settings of a ``map`` run."""

    surveys: tuple[Path | str, ...]
    """Files and folders; strings are fsspec URLs."""
    out: Path
    """Output folder."""
    tile_size: Annotated[float, NumberRange(0.05, 1000.0, "m")] = 3.0
    """Side of a tile, m."""
    pixels: Annotated[int, NumberRange(3, 255, whole=True)] = 15
    """Pixels along a side of a tile."""
    ground: Ground = "auto"
    """Points that are measured: ``all``; those of ``class`` 2; ``auto``: class 2 if most tiles have such points, else
    all; or those found by a cloth simulation filter (``csf``)."""
    align: Align = "report"
    """Height steps between flight lines: ``report`` measures them, ``on`` also takes them off where an offset or a
    tilt of each line explains them (which reads the survey twice), ``off`` does not measure them."""
    rating: Rating = "ride"
    """``ride`` rolls the vehicle over each tile; ``table`` looks up its texture and z range, as the paper does."""
    compat: Compat = "none"
    """``paper`` rates tiles by the rules of the paper."""
    vehicle: NameOrFile = "warthog"
    """A vehicle that ships with bumpymap, or the TOML file of one, with its calibration file in the same folder."""
    calibration: Path | None = None
    """A calibration file, used instead of ``vehicle``."""
    speed: Annotated[float | None, _SPEED] = None
    """Speed that the ride is rated at, m/s; None: that of the vehicle's profile."""
    speeds: tuple[Annotated[float, _SPEED], ...] | None = None
    """Speeds, m/s, at which c_r, c_roll and a_w are also computed, in speeds.tif; None: it is not written."""
    model: Path | None = None
    """The ONNX file of a texture network, used instead of the one that ships with bumpymap."""
    crs: str | None = None
    """CRS of surveys that state none."""
    force_crs: str | None = None
    """CRS of all surveys, whatever they state."""
    z_unit: ZUnit | None = None
    """Unit of heights, if the survey's CRS does not state it or is wrong."""
    local: bool = False
    """Accept coordinates without a CRS."""
    trust_points: bool = False
    """Continue if the extent in a file header contradicts the points."""
    skip_bad: bool = False
    """Continue without files that cannot be read."""
    max_unknown: Annotated[float | None, NumberRange(0.0, 1.0)] = None
    """Largest share of unknown tiles, 0..1, among those with points, with which a run succeeds. The layers are written
    anyway."""
    sheets: Annotated[float | None, NumberRange(0.001, 10_000.0, "km")] = None
    """Side of the sheets that the layers are written in, km, each sheet to a folder of its own; None: one map. It is
    rounded to whole blocks of 16 x 16 tiles."""
    overwrite: bool = False
    """Replace the layers of an earlier run."""
    resume: bool = False
    """Continue an interrupted run."""
    threads: Annotated[int, NumberRange(1, whole=True)] = field(default_factory=lambda: os.cpu_count() or 1)
    """Number of threads on this machine."""
    memory: str = "auto"
    """Memory to use beyond that of the interpreter and its libraries, such as ``1GB``; for each worker of a
    ``scheduler``. ``auto``: a quarter of the memory that is free when the run starts, at least 512 MB and at most 8 GB,
    or 1 GB for each worker."""
    scratch: Path | None = None
    """Folder for temporary files of points that do not fit in memory; None: in the output folder."""
    scheduler: str | None = None
    """Address of a dask.distributed scheduler whose workers are used; None: everything runs in this process."""
    features: FeatureSettings = field(default_factory=FeatureSettings)
    csf: CsfSettings = field(default_factory=CsfSettings)

    def __post_init__(self) -> None:
        _check_ranges(self, "`")
        _one_of("`ground`", self.ground, get_args(Ground))
        _one_of("`align`", self.align, get_args(Align))
        _one_of("`rating`", self.rating, get_args(Rating))
        _one_of("`compat`", self.compat, get_args(Compat))
        if self.z_unit is not None:
            _one_of("`z_unit`", self.z_unit, get_args(ZUnit))
        self._check_speeds()
        if self.resume and self.overwrite:
            raise UsageError(RESUME_OR_OVERWRITE)

    def _check_speeds(self) -> None:
        """Raise UsageError if the speeds are no list of different speeds, or the rating cannot tell them."""
        for speed in self.speeds or ():
            _refuse_outside("`speeds`", speed, _SPEED)
        if (
            self.speeds is not None
            and not 0 < len({f"{speed:g}" for speed in self.speeds}) == len(self.speeds) <= _MOST_SPEEDS
        ):
            raise UsageError(
                f"`speeds` is {', '.join(map(str, self.speeds)) or 'empty'}; give 1 to {_MOST_SPEEDS} different speeds "
                "in m/s"
            )
        given = next((name for name in ("speed", "speeds") if getattr(self, name) is not None), None)
        if given and (self.rating != "ride" or self.compat != "none"):
            name, value = ("rating", self.rating) if self.compat == "none" else ("compat", self.compat)
            raise UsageError(
                f"`{name}='{value}'` knows no speed: only the ride model does. Leave out `{given}`, or `{name}`"
            )


def names_a_file(text: str) -> bool:
    """Return whether a `NameOrFile` is a file: it ends in ``.toml`` or ``.csv``, or contains a slash."""
    return text.endswith((".toml", ".csv")) or "/" in text


def refuse_clashes(settings: Mapping[str, Any], clashes: Sequence[Clash], spelled: Callable[[str], str] = str) -> None:
    """Raise UsageError if settings exclude each other; ``spelled`` returns a setting's name for the message."""
    for clash in clashes:
        if clash.applies(settings):
            first, second = spelled(clash.first), spelled(clash.second)
            raise UsageError(f"{first} and {second} contradict each other: {clash.why}. Leave one of them out")


def override_settings(lower: Mapping[str, Any], upper: Mapping[str, Any], clashes: Sequence[Clash]) -> dict[str, Any]:
    """Return settings of two sources; ``upper`` also overrides the settings of ``lower`` that contradict it."""
    both = {**lower, **upper}
    lost = {
        name for clash in clashes if clash.applies(both) for name in (clash.first, clash.second) if name not in upper
    }
    return {name: value for name, value in both.items() if name not in lost}


def decide_ground(ground: Ground, tiles: int, flagged: float) -> bool:
    """Return whether only ground points are measured.

    Parameters
    ----------
    ground : Ground
    tiles : int
        Tiles of the survey that hold points.
    flagged : float
        Those of them that hold points of class 2.
    """
    if ground == "all":
        return False
    if ground == "class" and not flagged:
        raise BadInputError("`ground='class'`: no point of the survey has class 2 (ground). Use `ground='all'`")
    return ground in {"class", "csf"} or flagged > _CLASSIFIED_SHARE * tiles


def _check_ranges(settings: Any, quote: str = "") -> None:
    """Raise UsageError if a number of a dataclass is out of the range in its type; ``quote`` marks options."""
    for item in fields(settings):
        value = getattr(settings, item.name)
        found = next((part for part in get_args(item.type)[1:] if isinstance(part, NumberRange)), None)
        if found is not None and not (value is None and NoneType in get_args(get_args(item.type)[0])):
            _refuse_outside(f"{quote}{item.name}{quote}", value, found)


def _refuse_outside(name: str, value: Any, allowed: NumberRange) -> None:
    if fault := allowed.fault(value):
        raise UsageError(f"{name} is {value!r}; {fault}")


def _one_of(name: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise UsageError(f"{name} is {value!r}; it must be one of {', '.join(allowed)}")
