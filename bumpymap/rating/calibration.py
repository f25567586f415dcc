"""The calibration of a vehicle: its ride cost on each kind of ground, made by ``bumpymap calibrate``."""

import hashlib
import json
import math
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
    UsageError,
    VehicleBody,
    brief_repr,
    parse_json,
    path_of_call,
    read_regular,
    short_repr,
)
from bumpymap.rating.vehicle_body import Floor, body_table, comfort_of, flat_profile, with_floor

T = TypeVar("T")

_DRIVE_S = 10.0
"""Measured seconds of a drive, if the calibration does not give them."""
_FORMAT, _VERSION = "bumpymap-calibration", 2
"""Of the calibration file."""
MAP_SPEED = "map_speed_mps"
"""Key of ``motion``: the speed that a map was asked for."""
_MODELS = ("ride", "thin", "steps", "motion")
"""Fields that are fitted to the drives; empty while a calibration is made."""
_PREFERENCES = ("name", "description", "ride_weight", "fail_weight")
"""Keys of a vehicle profile that do not affect the simulated drives."""
_UNDRIVEN = ("body.", "comfort.", "floor.")
"""Tables that do not either."""
DEFAULT_FAIL_WEIGHT = 300.0
"""``fail_weight`` of profiles without that key, m."""


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

    @property
    def p_fail(self) -> float:
        """Share of the drives that failed."""
        return self.failed / self.drives


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
        _check_numbers(self)
        shape = (len(self.textures), len(self.z_range))
        for name in ("c_r", "c_r_log_sd", "p_fail", "drives"):
            table = getattr(self, name)
            if len(table) != shape[0] or any(len(line) != shape[1] for line in table):
                raise ValueError(f"table {name} is not {shape[0]} textures x {shape[1]} z ranges")
        if self.textures != TEXTURES:
            raise ValueError(f"textures are {self.textures}; this version knows {TEXTURES}")
        if not self.z_range or list(self.z_range) != sorted(set(self.z_range)) or self.z_range[0] <= 0:
            raise ValueError("z_range must be positive and increasing")
        if list(self.class_limits) != sorted(set(self.class_limits)) or self.class_limits[0] <= 0:
            raise ValueError("class_limits must be positive and increasing")
        for name in _MODELS:
            if not isinstance(getattr(self, name), dict):
                raise ValueError(f"{name} is {getattr(self, name)!r}; it must be an object")  # noqa: TRY004
        json.dumps(self._record(), allow_nan=False)  # raises ValueError if a number is not finite
        known = [c for line in self.c_r for c in line if c is not None]
        if any(line[0] is None for line in self.c_r) or min(known) <= 0:
            raise ValueError("c_r must be positive, and known at the lowest z range of every texture")

    @property
    def id(self) -> str:
        """Twelve hex digits of a hash of the content."""
        text = json.dumps(self._record(), sort_keys=True, allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    @property
    def cost_rule(self) -> CostRule:
        """The rule that decides which tiles are passable for the vehicle, and the weights of the cost."""
        seconds = self.settings.get("drive", {}).get("measure_s", _DRIVE_S)
        return CostRule(
            ride_weight=float(self.vehicle["ride_weight"]),
            fail_weight=float(self.vehicle.get("fail_weight", DEFAULT_FAIL_WEIGHT)),
            drive_m=float(seconds) * float(self.vehicle["speed_mps"]),
            slope_limit_deg=float(self.vehicle["slope_limit_deg"]),
        )

    @property
    def wheel_pixels(self) -> float:
        """Diameter of a wheel, px."""
        return 2.0 * float(self.vehicle["wheel"]["radius_m"]) * self.pixels / self.tile_size

    @property
    def body(self) -> VehicleBody:
        """Outline of the vehicle; defaults where the profile has none."""
        return VehicleBody(clearance_m=float(self.vehicle["belly"]["clearance_m"]), **body_table(self.vehicle))

    @property
    def floor(self) -> float:
        """C_r on even, level ground at the profile's speed, rad/m; 0 if the profile has none."""
        return float(self.vehicle.get("floor", {}).get("c_r_radpm", 0.0))

    @property
    def map_speed(self) -> float:
        """The speed [m/s] that the C_r of a map is for: the profile's, unless `at_speed` has set another."""
        own = float(self.vehicle["speed_mps"])
        return float(self.motion.get(MAP_SPEED, own))

    @property
    def map_floor(self) -> float:
        """`floor_at` the speed of the map: what enters every C_r of a map in power, rad/m."""
        return self.floor_at(self.map_speed)

    def floor_at(self, speed: float) -> float:
        """Return the floor at a speed [m/s], rad/m: lugs and drive train turn the vehicle at a rate in time."""
        return self.floor * float(self.vehicle["speed_mps"]) / speed

    @property
    def floor_before(self) -> float:
        """Return the floor before the calibration was moved to drives: a profile that has it is that of the vehicle."""
        before: float = self.settings.get("moved_to_drives", {}).get("floor", [self.floor])[0]
        return before

    @property
    def map_limits(self) -> tuple[float, ...]:
        """``class_limits`` with the floor, for values that hold it, rad/m: the floor moves no tile to another class."""
        return tuple(with_floor(np.array(self.class_limits), self.map_floor).tolist())

    def require_grid(self, tile_size: float, pixels: int) -> None:
        """Raise UsageError if tiles to rate differ in size [m] or number of pixels from the calibration's."""
        if (self.tile_size, self.pixels) != (tile_size, pixels):
            name = str(self.vehicle["name"])
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
            return cls(**{each.name: _tuples(record[each.name]) for each in fields(cls)})
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            raise BadInputError(f"{origin} is a damaged calibration: {error!r}. {hint}") from error

    @classmethod
    def load(cls, path: str | Path) -> "Calibration":
        """Read a calibration file. Raises BadInputError if it is not one."""
        place = path_of_call("the calibration", path)
        try:
            text = read_regular(Path(place)).decode()
        except OSError as error:
            hint = (
                f". That of an included vehicle: Calibration.shipped('{path}')"
                if place in shipped_calibrations()
                else ""
            )
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
        undriven = (*_PREFERENCES, *(table.rstrip(".") for table in _UNDRIVEN))
        return {"fail_weight": DEFAULT_FAIL_WEIGHT} | {
            key: value for key, value in self.vehicle.items() if key in undriven
        }

    def with_preferences(self, profile: dict[str, Any], origin: str) -> "Calibration":
        """Return this calibration with the preferences, ``[body]``, ``[comfort]``, ``[floor]`` of a profile.

        They change the layers, so a changed preference changes the ``id``. ``profile``: a vehicle profile, as in its
        TOML file; ``origin``: name of the calibration for the error message. Raises BadInputError if any other key
        differs, so that the profile is of another vehicle.
        """
        driven, given = flat_profile(self.vehicle), flat_profile(profile)
        kept = [key for key in {**driven, **given} if key not in _PREFERENCES and not key.startswith(_UNDRIVEN)]
        differ = [key for key in kept if driven.get(key) != given.get(key)]
        if differ:
            named = "; ".join(f"{key} is {given.get(key)}, was {driven.get(key)}" for key in differ)
            raise BadInputError(f"{origin} was made for another vehicle: {named}")
        own = self.preferences
        changed = {key: given[key] for key in _PREFERENCES if key in given and given[key] != own.get(key)}
        if (body := body_table(profile)) != body_table(self.vehicle):
            changed["body"] = body
        if (comfort := comfort_of(profile)) != comfort_of(self.vehicle):
            changed["comfort"] = asdict(comfort)
        floor = float(profile.get("floor", {}).get("c_r_radpm", 0.0))
        if floor not in (self.floor, self.floor_before):
            changed["floor"] = asdict(Floor(floor))
        return replace(self, vehicle=self.vehicle | changed) if changed else self


def _check_numbers(calibration: Calibration) -> None:
    """Raise ValueError if a number is missing, not finite or out of range."""
    vehicle = calibration.vehicle
    rule = calibration.cost_rule
    if not isinstance(vehicle["name"], str):
        raise ValueError(f"the vehicle's name is {vehicle['name']!r}; it must be a string")  # noqa: TRY004 (of a file)
    if len(calibration.class_limits) != 3 or len(calibration.class_c_r) != 4:
        raise ValueError("there must be 3 class_limits and 4 class_c_r")
    tables = [calibration.p_fail, calibration.drives, calibration.c_r, calibration.c_r_log_sd]
    gaps = [number for table in tables[2:] for line in table for number in line if number is None]
    numbers = [number for table in tables for line in table for number in line]
    numbers += [vehicle["ride_weight"], vehicle["slope_limit_deg"], rule.fail_weight, rule.drive_m]
    numbers += [*calibration.z_range, *calibration.class_limits, *calibration.class_c_r]
    numbers += [calibration.tile_size, calibration.pixels, *asdict(calibration.body).values(), calibration.floor]
    numbers += [calibration.floor_before, calibration.map_speed]
    known = [value for value in numbers if isinstance(value, int | float) and not isinstance(value, bool)]
    if sum(map(math.isfinite, known)) + len(gaps) != len(numbers):
        raise ValueError("a number is missing, not finite, or no number")
    if calibration.floor < 0:
        raise ValueError("[floor] must not be negative")
    if calibration.map_speed <= 0:
        raise ValueError(f"{MAP_SPEED} must be positive")
    if rule.drive_m <= 0 or min(rule.ride_weight, rule.fail_weight) < 0:
        raise ValueError("speed_mps and measure_s must be positive, ride_weight and fail_weight not negative")


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


def shipped_calibrations() -> list[str]:
    """Return the names of the vehicles whose calibration is included in the package."""
    folder = files("bumpymap.rating") / "data" / "calibrations"
    return sorted(entry.name.removesuffix(".json") for entry in folder.iterdir() if entry.name.endswith(".json"))


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value
