"""The calibration of a vehicle, by ``bumpymap calibrate``: its ride cost on each kind of ground; how to find it."""

import hashlib
import json
import shlex
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields, replace
from functools import wraps
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from bumpymap.core import (
    INCLUDED_PIXELS,
    TEXTURES,
    BadInputError,
    CostRule,
    Nullable,
    Number,
    UsageError,
    VehicleBody,
    brief_repr,
    parse_json,
    path_of_call,
    read_regular,
    shape_fault,
    short_repr,
)
from bumpymap.rating.vehicle_profile import Vehicle, flat_profile, with_floor

T = TypeVar("T")

_DRIVE_S = 10.0
"""Measured seconds of a drive, if the calibration does not give them."""
_FORMAT, _VERSION = "bumpymap-calibration", 2
"""Of the calibration file."""
MAP_SPEED = "map_speed_mps"
"""Key of ``motion``: the speed that a map was asked for."""
_PREFERENCES = ("name", "description", "ride_weight", "fail_weight", "body", "comfort", "floor")
"""Keys and tables of a vehicle profile that do not affect the simulated drives."""
_MORE = Number(1e-9)
"""A positive number."""
_SHAPE = {
    "tile_size": _MORE, "pixels": Number(1, whole=True), "z_range": [_MORE], "c_r": [[Nullable(_MORE)]],
    "c_r_log_sd": [[Nullable(Number(0))]], "p_fail": [[Number(0, 1)]], "drives": [[Number(0, whole=True)]],
    "class_limits": (_MORE,) * 3, "class_c_r": (_MORE,) * 4, "ride": dict, "thin": dict, "steps": dict,
    "motion": {f"{MAP_SPEED}?": _MORE},
    "settings": {"drive?": {"measure_s?": _MORE}, "moved_to_drives?": {"floor?": (Number(0),) * 2}},
}  # fmt: skip
"""Of the file, see `shape_fault`."""


@dataclass(frozen=True, slots=True)
class DrivenTerrain:
    """Results of the drives over one terrain of the library, to which a ride model is fitted."""

    kind: str
    index: int
    """Number of the terrain within its kind."""
    c_r: float | None
    """Mean over the completed drives, rad/m; None if there are none."""
    c_r_error: float | None
    """Standard error of that mean, rad/m; None with fewer than two completed drives."""
    completed: int
    """Drives that reached their end."""
    stuck: int
    rolled: int

    @property
    def failed(self) -> int:
        """Drives that got stuck or rolled over."""
        return self.stuck + self.rolled

    @property
    def drives(self) -> int:
        """Number of all drives."""
        return self.completed + self.failed


@dataclass(frozen=True, slots=True)
class Calibration:
    """Ride cost (C_r) and probability of failure (p_fail) of a vehicle by texture and z_range, and its class limits.

    They are measured in simulated drives. Tables are nested tuples ``[texture][z_range]``.
    """

    __repr__ = brief_repr

    vehicle: dict[str, Any]
    """The vehicle profile, as in its TOML file."""
    tile_size: float
    """Side of the driven patches, m."""
    pixels: int
    """Pixels along a side of a patch."""
    textures: tuple[str, ...]
    """Rows of the tables."""
    z_range: tuple[float, ...]
    """Columns of the tables: max - min of the driven patches after their plane is removed, m, increasing."""
    c_r: tuple[tuple[float | None, ...], ...]
    """Mean C_r over the completed drives, rad/m; None if none was completed."""
    c_r_log_sd: tuple[tuple[float | None, ...], ...]
    """Standard deviation of ln C_r between patches of one cell; None with fewer than two patches."""
    p_fail: tuple[tuple[float, ...], ...]
    """Share of the drives that rolled over or got stuck, 0..1."""
    drives: tuple[tuple[int, ...], ...]
    """Number of drives, including failed ones."""
    class_limits: tuple[float, float, float]
    """C_r between class 0 and 1, 1 and 2, 2 and 3, rad/m."""
    class_c_r: tuple[float, float, float, float]
    """Mean C_r of the driven terrains of each class, rad/m."""
    ride: dict[str, Any] = field(default_factory=dict)
    """Coefficients of the ride model, fitted to drives over the terrain library."""
    thin: dict[str, Any] = field(default_factory=dict)
    """Coefficients of the model of thin surveys."""
    settings: dict[str, Any] = field(default_factory=dict)
    """Everything needed to repeat the calibration: seed, command, versions, integrator settings, rule of the class
    limits. ``library`` holds the results of the drives over the terrain library, to fit a ride model again."""
    steps: dict[str, Any] = field(default_factory=dict)
    """Effect of steps on the vehicle, see ``bumpymap.rating.steps``."""
    motion: dict[str, Any] = field(default_factory=dict)
    """Ride at other speeds, roll and lift, see ``bumpymap.rating.ride.speed``."""

    def __post_init__(self) -> None:
        if self.textures != TEXTURES:
            raise ValueError(f"textures are {self.textures}; this version knows {TEXTURES}")
        for name in ("c_r", "c_r_log_sd", "p_fail", "drives"):
            if [len(line) for line in getattr(self, name)] != [len(self.z_range)] * len(TEXTURES):
                raise ValueError(f"table {name} is not {len(TEXTURES)} textures x {len(self.z_range)} z ranges")
        for name, rising in (("z_range", self.z_range), ("class_limits", self.class_limits)):
            if not rising or list(rising) != sorted(set(rising)):
                raise ValueError(f"{name} must be increasing")
        json.dumps(self._record(), allow_nan=False)  # raises ValueError if a number is not finite
        if any(line[0] is None for line in self.c_r):
            raise ValueError("c_r must be known at the lowest z range of every texture")

    @property
    def id(self) -> str:
        """Twelve hex digits of a hash of the content."""
        text = json.dumps(self._record(), sort_keys=True, allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    @property
    def profile(self) -> Vehicle:
        """The vehicle, with defaults for what its record leaves out; raises BadInputError if a value is not allowed."""
        return _profile(self)

    @property
    def cost_rule(self) -> CostRule:
        """The rule that decides which tiles are passable for the vehicle, and the weights of the cost."""
        seconds = self.settings.get("drive", {}).get("measure_s", _DRIVE_S)
        return CostRule(
            ride_weight=self.profile.ride_weight,
            fail_weight=self.profile.fail_weight,
            drive_m=float(seconds) * self.profile.speed_mps,
            slope_limit_deg=self.profile.slope_limit_deg,
        )

    @property
    def wheel_pixels(self) -> float:
        """Diameter of a wheel, px."""
        return 2.0 * self.profile.wheel.radius_m * self.pixels / self.tile_size

    @property
    def body(self) -> VehicleBody:
        """Outline of the vehicle."""
        return VehicleBody(clearance_m=self.profile.belly.clearance_m, **asdict(self.profile.body))

    @property
    def floor(self) -> float:
        """C_r on even, level ground at the profile's speed, rad/m; 0 if the profile has none."""
        return self.profile.floor.c_r_radpm

    @property
    def map_speed(self) -> float:
        """The speed [m/s] that the C_r of a map is for: the profile's, unless `at_speed` has set another."""
        return float(self.motion.get(MAP_SPEED, self.profile.speed_mps))

    @property
    def map_floor(self) -> float:
        """`floor_at` the speed of the map: what enters every C_r of a map in power, rad/m."""
        return self.floor_at(self.map_speed)

    def floor_at(self, speed: float) -> float:
        """Return the floor at a speed [m/s], rad/m: lugs and drive train turn the vehicle at a rate in time."""
        return self.floor * self.profile.speed_mps / speed

    @property
    def map_limits(self) -> tuple[float, ...]:
        """``class_limits`` with the floor, for values that hold it, rad/m: the floor moves no tile to another class."""
        return tuple(with_floor(np.array(self.class_limits), self.map_floor).tolist())

    def require_grid(self, tile_size: float, pixels: int) -> None:
        """Raise UsageError if tiles to rate differ in size [m] or number of pixels from the calibration's."""
        if (self.tile_size, self.pixels) != (tile_size, pixels):
            name = self.profile.name
            vehicle = name if name in shipped_calibrations() else "PROFILE.toml"
            raise UsageError(
                f"the calibration {self.id} was made for tiles of {self.tile_size:g} m with {self.pixels} pixels, the "
                f"map has {tile_size:g} m with {pixels}. Use `tile_size={self.tile_size:g}`, `pixels={self.pixels}`, "
                "or an included vehicle with tiles of 3, 5 or 6 m, or make a calibration that drives over patches of "
                f"your size: bumpymap calibrate --vehicle {vehicle} --tile-size {tile_size:g} --set pixels={pixels} "
                "--out my.json; then pass `calibration='my.json'`"
            )

    def _record(self) -> dict[str, Any]:
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def to_json(self) -> str:
        """Return the text of the calibration file."""
        return json.dumps({"format": _FORMAT, "version": _VERSION, "id": self.id, **self._record()}, indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str, origin: str) -> "Calibration":
        """Read the text of a calibration file.

        ``origin``: name of the file for error messages. Raises BadInputError if the text is not a calibration, is of
        another version, or has a table of the wrong shape.
        """
        hint = "Make one with: bumpymap calibrate --vehicle FILE --out CALIBRATION.json"
        try:
            record = parse_json(text)
        except ValueError:
            record = None
        if not isinstance(record, dict) or record.get("format") != _FORMAT:
            raise BadInputError(f"{origin} is not a bumpymap calibration. {hint}")
        if record.get("version") != _VERSION:
            raise BadInputError(
                f"{origin} is a calibration of version {record.get('version')}; "
                f"this bumpymap reads version {_VERSION}. {hint}"
            )
        try:
            values = {each.name: _tuples(record[each.name]) for each in fields(cls)}
            if fault := shape_fault(record, _SHAPE):
                raise ValueError(fault)  # noqa: TRY301 (as what the constructor refuses)
            Vehicle.from_dict(record["vehicle"], f"{origin}, vehicle")
            return cls(**values)
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            raise BadInputError(f"{origin} is a damaged calibration: {error!r}. {hint}") from error

    @classmethod
    def load(cls, path: str | Path) -> "Calibration":
        """Read a calibration file. Raises BadInputError if it is not one."""
        place = path_of_call("the calibration", path)
        try:
            text = read_regular(Path(place)).decode()
        except OSError as error:
            is_included = place in shipped_calibrations()
            hint = f". That of an included vehicle: Calibration.shipped('{path}')" if is_included else ""
            raise BadInputError(f"cannot read the calibration {path}: {error.strerror}{hint}") from error
        except UnicodeDecodeError:
            text = ""
        return cls.from_json(text, str(path))

    @classmethod
    def shipped(cls, vehicle: str, tile_size: float = 3.0) -> "Calibration":
        """Read the calibration of an included vehicle, such as ``warthog``, for tiles of 3, 5 or 6 m.

        For other sizes it is that for 3 m, which `require_grid` refuses. Raises UsageError if no calibration for a
        vehicle of that name is included.
        """
        known = shipped_calibrations()
        if not isinstance(vehicle, str) or vehicle not in known:
            raise UsageError(
                f"no calibration for a vehicle named {short_repr(vehicle)} is included; available are: "
                f"{', '.join(known)}. "
                "Calibrate another vehicle (bumpymap calibrate --vehicle NAME_OR_FILE --out FILE) and pass the result "
                "with `calibration='FILE'`"
            )
        resource = files("bumpymap.rating") / "data" / "calibrations"
        if tile_size in INCLUDED_PIXELS and tile_size != 3.0:
            resource /= f"{tile_size:g}m"
        resource /= f"{vehicle}.json"
        return cls.from_json(resource.read_text(encoding="utf-8"), f"calibration {vehicle}")

    @property
    def preferences(self) -> dict[str, Any]:
        """Name, description, weights and tables of the vehicle that do not affect the drives."""
        usual = {"fail_weight": self.profile.fail_weight}
        return usual | {key: value for key, value in self.vehicle.items() if key in _PREFERENCES}

    def with_preferences(self, vehicle: Vehicle, origin: str) -> "Calibration":
        """Return this calibration with the preferences, ``[body]``, ``[comfort]``, ``[floor]`` of a profile.

        They change the layers, so a changed preference changes the ``id``. ``origin``: name of the calibration for the
        error message. Raises BadInputError if any other key differs, so that the profile is of another vehicle.
        """
        driven, given = self.profile.to_dict(), vehicle.to_dict()
        old, new = (
            flat_profile({key: value for key, value in each.items() if key not in _PREFERENCES})
            for each in (driven, given)
        )
        if differ := [f"{key} is {new[key]}, was {old[key]}" for key in old if new[key] != old[key]]:
            raise BadInputError(f"{origin} was made for another vehicle: {'; '.join(differ)}")
        changed = {key: given[key] for key in _PREFERENCES if given[key] != driven[key]}
        # Before the calibration was moved to drives: a profile that has this floor is that of the vehicle.
        if vehicle.floor.c_r_radpm == self.settings.get("moved_to_drives", {}).get("floor", [self.floor])[0]:
            changed.pop("floor", None)
        return replace(self, vehicle=self.vehicle | changed) if changed else self


def remembered(function: Callable[[Calibration], T]) -> Callable[[Calibration], T]:
    """Keep what a function made of the calibration that it was last called with: a run calls it for every block."""
    last: list[tuple[Calibration, T]] = []

    @wraps(function)
    def ask(calibration: Calibration) -> T:
        for known, made in tuple(last):
            if known is calibration:
                return made
        made = function(calibration)
        last[:] = [(calibration, made)]
        return made

    return ask


@remembered
def _profile(calibration: Calibration) -> Vehicle:
    return Vehicle.from_dict(calibration.vehicle, f"calibration {calibration.id}, vehicle")


def shipped_calibrations() -> list[str]:
    """Return the names of the vehicles whose calibration is included in the package."""
    folder = files("bumpymap.rating") / "data" / "calibrations"
    return sorted(entry.name.removesuffix(".json") for entry in folder.iterdir() if entry.name.endswith(".json"))


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def find_calibration(vehicle: str | Path, file: Path | None = None, tile_size: float = 3.0) -> Calibration:
    """Find the calibration of a vehicle, an included one for tiles of ``tile_size`` (3, 5 or 6 m).

    ``vehicle``: name of an included vehicle, or a TOML file, whose calibration is the JSON file of the same name beside
    it. If there is none and the profile equals that of an included vehicle, the calibration of that is used. Name,
    description and weights are those of the TOML file. ``file``: a calibration file; ``vehicle`` is then ignored.

    Raises UsageError if there is no vehicle of that name, or no such file; BadInputError if profile or calibration
    cannot be read, or are of different vehicles.
    """
    if file is not None:
        return Calibration.load(file)
    profile = Vehicle.load(vehicle)
    if str(vehicle) in shipped_calibrations():
        return Calibration.shipped(str(vehicle), tile_size)
    path = Path(vehicle)
    beside = path.with_suffix(".json")
    again = f"bumpymap calibrate --vehicle {shlex.quote(str(path))} --out {shlex.quote(str(beside))}"
    if beside.exists():
        calibration = Calibration.load(beside)
        try:
            return calibration.with_preferences(profile, str(beside))
        except BadInputError as error:
            raise BadInputError(f"{error}. Calibrate for the vehicle of {path}: {again} --overwrite") from error
    for name in shipped_calibrations():
        try:
            return Calibration.shipped(name, tile_size).with_preferences(profile, name)
        except BadInputError:  # another vehicle
            continue
    raise BadInputError(
        f"there is no calibration of {path}: {beside} does not exist. Make it: {again} (--quick makes a rough one)"
    )
