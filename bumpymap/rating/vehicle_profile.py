"""Vehicle profiles: dimensions, masses, preferences of a vehicle, read from TOML; its calibration is found here."""

import json
import math
import re
import shlex
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any

from bumpymap.core import (
    UNFILLED,
    BadInputError,
    Declared,
    OutputError,
    Setting,
    UsageError,
    allowed_values,
    parse_record,
    path_of_call,
    read_toml,
    refuse_faults,
    short_repr,
)
from bumpymap.rating.calibration import DEFAULT_FAIL_WEIGHT, Calibration, shipped_calibrations
from bumpymap.rating.ride.speed import at_speed
from bumpymap.rating.vehicle_body import (
    ESTIMATED,
    SUSPENSION,
    Body,
    Comfort,
    Floor,
    Whole,
    body_table,
    estimate_profile,
    flat_profile,
    plain_lists,
    profile_keys,
)

_SHORT = "; or give mass_kg and suspension, from which most other values are estimated"
_SCHEMA = "`bumpymap vehicle new NAME` writes a file to fill in, with units and ranges"
_LONGEST_BELLY = 4.0
"""Longest belly in wheelbases; a bus with its overhangs has about two."""
_LIGHTEST, _HEAVIEST = 5.0, 3000.0
"""Bounds of mass / size^3, kg/m3, with size = sqrt(length * width); included vehicles have 98 to 140."""
_GYRATION = {"chassis": (0.03, 0.6), "rocker": (0.003, 0.6)}
"""Bounds of the radius of gyration, sqrt(moment / mass), over the vehicle's size. Even two masses at the ends of a body
stay below 0.6; included vehicles have 0.15 to 0.36 (chassis) and 0.02 to 0.21 (rocker)."""
_Moments = tuple[float, float, float]
"""Roll (about the forward axis), pitch (left axis), yaw (upward axis)."""


@dataclass(frozen=True, slots=True)
class Chassis:
    """The body that carries the pitch-rate sensor."""

    mass_kg: Annotated[float, Setting("everything except rockers and wheels, payload included", None, 0.2, 1e6, "kg")]
    inertia_kgm2: Annotated[
        _Moments, Setting("moments of inertia [roll, pitch, yaw] about the centre of mass", None, 1e-6, 1e8, "kg m2")
    ]
    com_height_m: Annotated[
        float, Setting("height of the centre of mass above the axles; may be negative", None, -2, 6, "m")
    ]
    """Measured with the vehicle on level ground."""


@dataclass(frozen=True, slots=True)
class Belly:
    """The underside of the chassis: a level plate centred between the wheels, with walls above it."""

    length_m: Annotated[
        float, Setting("length along the vehicle, centred between the axles, bumpers included", None, 0.05, 30, "m")
    ]
    width_m: Annotated[float, Setting("width across the vehicle", None, 0.02, 15, "m")]
    clearance_m: Annotated[
        float, Setting("height above level ground of the lowest part that could hit a stone", None, 0.005, 5, "m")
    ]


@dataclass(frozen=True, slots=True)
class Rocker:
    """The beam on each side that joins a front and a rear wheel and pivots about the chassis' left axis."""

    mass_kg: Annotated[
        float, Setting("mass of one rocker: the beam that joins a front and a rear wheel", None, 0.005, 1e5, "kg")
    ]
    inertia_kgm2: Annotated[
        _Moments, Setting("moments of inertia [roll, pitch, yaw] about its centre", None, 1e-8, 1e7, "kg m2")
    ]
    limit_rad: Annotated[float, Setting("end stop, up and down from level", None, 0, 1.2, "rad")]
    stiffness_nm_per_rad: Annotated[
        float, Setting("stiffness of the spring that returns it to level; 0 for a free rocker", None, 0, 1e9, "N m/rad")
    ]
    damping_nms_per_rad: Annotated[float, Setting("damping coefficient", None, 0, 1e8, "N m s/rad")]


@dataclass(frozen=True, slots=True)
class Wheel:
    """One of the four wheels: a rigid cylinder."""

    mass_kg: Annotated[float, Setting("mass of one wheel", None, 0.005, 2e4, "kg")]
    radius_m: Annotated[float, Setting("radius", None, 0.02, 3, "m")]
    width_m: Annotated[float, Setting("width", None, 0.005, 3, "m")]


@dataclass(frozen=True, slots=True)
class Vehicle:
    """A vehicle profile: four wheels on two rockers under a chassis, driving speed and preferences.

    Attributes have the names of the keys in the TOML file; the page "Describe your vehicle" lists units and bounds.
    """

    name: str
    description: str
    wheelbase_m: Annotated[float, Setting("distance between the axles", None, 0.1, 20, "m")]
    track_m: Annotated[float, Setting("distance between the wheel centres of one axle", None, 0.05, 15, "m")]
    speed_mps: Annotated[
        float,
        Setting(
            "the speed of every drive; C_r depends on it, so choose the speed at which you will drive",
            None,
            0.05,
            15,
            "m/s",
        ),
    ]
    slope_limit_deg: Annotated[float, Setting("steeper tiles are class 3 and not passable", None, 3, 60, "deg")]
    ride_weight: Annotated[
        float,
        Setting(
            "the detour that is acceptable to avoid one radian of pitch motion; a preference", None, 0, 1000, "m/rad"
        ),
    ] = field(default=5.0, kw_only=True)
    """cost = 1 + ride_weight * c_r + fail_weight * hazard."""
    fail_weight: Annotated[
        float, Setting("the detour that is acceptable to avoid one failure; a preference", None, 0, 100_000, "m")
    ] = field(default=DEFAULT_FAIL_WEIGHT, kw_only=True)
    chassis: Chassis
    belly: Belly
    rocker: Rocker
    wheel: Wheel
    body: Body = field(default=Body(), kw_only=True)
    """Does not affect the drives; what the profile leaves out follows from the other keys."""
    comfort: Comfort = field(default=Comfort(), kw_only=True)
    """Does not affect the drives: how fast a map says that ground is driven."""
    floor: Floor = field(default=Floor(), kw_only=True)
    """Does not affect the drives either; added to what they say."""

    @property
    def mass_kg(self) -> float:
        """Mass of the whole vehicle in kg."""
        return self.chassis.mass_kg + 2 * self.rocker.mass_kg + 4 * self.wheel.mass_kg

    @property
    def tips_deg(self) -> float:
        """Slope across which the vehicle at rest tips over: of half the track over the height of the centre of mass."""
        height = self.wheel.radius_m + self.chassis.com_height_m * self.chassis.mass_kg / self.mass_kg
        return math.degrees(math.atan2(0.5 * self.track_m, height))

    @property
    def length_m(self) -> float:
        """Length of the whole vehicle in metres, the larger of belly and wheels."""
        return max(self.belly.length_m, self.wheelbase_m + 2 * self.wheel.radius_m)

    @property
    def width_m(self) -> float:
        """Width of the whole vehicle in metres, the larger of belly and wheels."""
        return max(self.belly.width_m, self.track_m + self.wheel.width_m)

    @classmethod
    def load(cls, name_or_path: str | Path) -> "Vehicle":
        """Read a vehicle profile: the name of an included vehicle, such as ``warthog``, or a TOML file.

        Raises UsageError if there is no such vehicle or file, BadInputError if the file is not TOML, or a value is
        missing or not plausible.
        """
        return cls.from_dict(*_profile_record(name_or_path))

    def to_dict(self) -> dict[str, Any]:
        """Return the profile as a nested dictionary, as in its TOML file."""
        plain: dict[str, Any] = plain_lists(asdict(self))
        return plain

    @classmethod
    def from_dict(cls, record: dict[str, Any], origin: str) -> "Vehicle":
        """Check a nested dictionary and make a profile of it.

        ``record``: the profile, as in a TOML file; ``origin``: name of the file for error messages. Raises
        BadInputError, whose message lists all faults, if a key is unknown or missing, or a value is of the wrong type
        or not plausible.
        """
        completed, _, of_whole = estimate_profile(record)
        arguments, faults = parse_record(completed, cls, Path(), complete=True)
        if completed is not record:  # a short profile does not lack what would be estimated
            estimated = tuple(f"missing {name}:" for name in ESTIMATED)
            faults = of_whole + [fault for fault in faults if not fault.startswith(estimated)]
        if not faults:
            profile = cls(**arguments)
            profile = replace(profile, body=Body(**body_table(profile.to_dict())))
            faults = [
                f"{key} is {short_repr(text)}; it must be a text of one line that is not empty"
                for key, text in (("name", profile.name), ("description", profile.description))
                if not (text.strip() and text.isprintable())
            ]
            faults += [*_size_faults(profile), *_mass_faults(profile, record.get("mass_kg", profile.mass_kg))]
        lacking = completed is record and any(fault.startswith("missing") for fault in faults)
        refuse_faults(faults, origin, BadInputError, f"; {_SCHEMA}{_SHORT if lacking else ''}")
        return profile


KEYS = profile_keys(Vehicle)
"""All numeric keys of a profile, in the order of the file."""


def _profile_record(name_or_path: str | Path) -> tuple[dict[str, Any], str]:
    """Return a profile as its file has it, and what to call it in messages."""
    if str(name_or_path) in shipped_profiles():
        with as_file(files("bumpymap.rating") / "data" / "vehicles" / f"{name_or_path}.toml") as shipped:
            return read_toml(shipped, "the vehicle profile", BadInputError), f"vehicle profile {name_or_path}"
    path = Path(path_of_call("the vehicle", name_or_path))
    if not path.exists():
        raise UsageError(
            f"no vehicle '{name_or_path}': it is neither a file nor an included vehicle "
            f"({', '.join(shipped_profiles())}). Give one of these names, or a TOML file; "
            "bumpymap vehicle new NAME writes a template"
        )
    return read_toml(path, "the vehicle profile", BadInputError), str(path)


def shipped_profiles() -> list[str]:
    """Return the names of the included vehicle profiles."""
    folder = files("bumpymap.rating") / "data" / "vehicles"
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def estimated_values(name_or_path: str | Path) -> dict[str, Any]:
    """Return what a short profile leaves out and `Vehicle.load` estimates, by key, such as ``chassis.com_height_m``."""
    return estimate_profile(_profile_record(name_or_path)[0])[1]


def _size_faults(profile: Vehicle) -> Iterator[str]:
    """Describe each dimension that contradicts another."""
    wheel, belly, body = profile.wheel, profile.belly, profile.body
    radius, between = wheel.radius_m, profile.track_m - wheel.width_m
    under, wide = max(2 * radius, belly.clearance_m), profile.width_m
    if 2 * radius >= profile.wheelbase_m:
        yield (
            f"wheel.radius_m is {radius:g} and wheelbase_m {profile.wheelbase_m:g}; front and rear wheels would touch: "
            "the wheelbase must exceed twice the radius"
        )
    if between <= 0:
        yield (
            f"wheel.width_m is {wheel.width_m:g} and track_m {profile.track_m:g}; the track must exceed the wheel width"
        )
    if belly.width_m > between and belly.clearance_m < 2 * radius:
        yield (
            f"belly.width_m is {belly.width_m:g}, and the wheels are {between:g} apart on the inside; "
            "a belly below the top of the wheels must fit between them"
        )
    if belly.length_m > _LONGEST_BELLY * profile.wheelbase_m:
        yield (
            f"belly.length_m is {belly.length_m:g} and wheelbase_m {profile.wheelbase_m:g}; a belly has at most "
            f"{_LONGEST_BELLY:g} times the wheelbase"
        )
    if profile.chassis.com_height_m < -radius:
        yield (
            f"chassis.com_height_m is {profile.chassis.com_height_m:g}, below the ground; it is the height above the "
            f"axles and must be above -wheel.radius_m = {-radius:g}"
        )
    if body.height_m < under:
        yield f"body.height_m is {body.height_m:g}, and wheels and belly reach up to {under:g}; it must not be lower"
    elif body.height_m <= body.brush_stem_m:
        yield f"body.height_m is {body.height_m:g} and body.brush_stem_m {body.brush_stem_m:g}; it must be higher"
    if (own := profile.floor.c_r_radpm * profile.speed_mps) >= profile.comfort.pitch_rate_radps:
        yield (
            f"comfort.pitch_rate_radps is {profile.comfort.pitch_rate_radps:g}, and [floor] says that even ground "
            f"takes {own:.3g} rad/s: no speed would be slow enough"
        )
    if body.width_m < round(wide, 2) - 0.005:  # the default is rounded
        yield f"body.width_m is {body.width_m:g}, and belly and wheels are {wide:.3g} wide; it must not be less"


def _mass_faults(profile: Vehicle, whole: float) -> Iterator[str]:
    """Describe each mass or moment that does not fit the size, or the mass of the whole vehicle, kg."""
    if not math.isclose(whole, profile.mass_kg, rel_tol=0.01):
        yield (
            f"mass_kg is {whole:g}, and chassis, rockers and wheels weigh {profile.mass_kg:g} together: leave one of "
            "them out"
        )
    long, wide = profile.length_m, profile.width_m
    low, high = (density * math.sqrt(long * wide) ** 3 for density in (_LIGHTEST, _HEAVIEST))
    if not low <= profile.mass_kg <= high:
        yield (
            f"the whole vehicle weighs {profile.mass_kg:,.6g} kg and is {long:.3g} m long and {wide:.3g} m wide; one "
            f"of that size weighs between {low:.3g} and {high:.3g} kg. Are masses in kilograms and lengths in metres?"
        )
    size = max(long, wide)
    for table, shares in _GYRATION.items():
        part: Chassis | Rocker = getattr(profile, table)
        if 2 * max(part.inertia_kgm2) > sum(part.inertia_kgm2):
            yield (
                f"{table}.inertia_kgm2 is {short_repr(list(part.inertia_kgm2))}; each moment must be at most the sum "
                "of the two others (no rigid body has other moments)"
            )
        low, high = (part.mass_kg * (share * size) ** 2 for share in shares)
        if min(part.inertia_kgm2) < low or max(part.inertia_kgm2) > high:
            yield (
                f"{table}.inertia_kgm2 is {short_repr(list(part.inertia_kgm2))}: with {table}.mass_kg = "
                f"{part.mass_kg:g} in a vehicle of {size:.3g} m, each moment lies between {low:.2g} and {high:.2g} kg "
                "m2; a solid box of mass m, length l, width w and height h has m (w2 + h2) / 12, m (l2 + h2) / 12, "
                "m (l2 + w2) / 12"
            )


_NAME = re.compile(r"[\w-]{1,64}")


def write_profile_template(name: str, path: Path, like: str | None) -> None:
    """Write `profile_template` to a new file.

    Raises UsageError if the name is that of an included vehicle, or not one word, or there is no vehicle ``like``;
    OutputError if the file exists, or cannot be written.
    """
    if not _NAME.fullmatch(name):
        raise UsageError(f"the name of a vehicle is {name!r}; it must be up to 64 letters, digits, _ and -")
    if name in shipped_profiles():
        raise UsageError(f"a vehicle named {name} is included in bumpymap: choose another name, or --like {name}")
    text = profile_template(name, like)
    try:
        with path.open("x", encoding="utf-8") as file:  # "x" does not follow a symbolic link either
            try:
                file.write(text)
                file.flush()
            except OSError:
                path.unlink()
                raise
    except FileExistsError as error:
        raise OutputError(f"{path} exists and is not overwritten: give another --out") from error
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}; give another --out") from error


def profile_template(name: str, like: str | None) -> str:
    """Return the text of a profile to edit, of a new vehicle of this name.

    ``like``: a vehicle (name or TOML file) to copy every number from; None: a short profile, with placeholders that
    `vehicle check` reports.
    """
    lines = ["# A vehicle profile for bumpymap. Check it with: bumpymap vehicle check FILE"]
    if like is None:
        lines += [
            f'# Replace each "{UNFILLED}" by a value. Inertia, centre of mass, springs, belly, outline are estimated',
            "# from these values: the check shows them, and each may be set.",
        ]
        keys = tuple(key for key in KEYS if key.default is None and key.name not in ESTIMATED)
        values, description = {key.name: UNFILLED for key in keys}, UNFILLED
    else:
        model = Vehicle.load(like).to_dict()
        lines.append(f"# The numbers are those of {model['name']}: change whatever differs.")
        keys, description = KEYS, f"like {model['name']}"
        values = flat_profile(model)
    lines += [f"name = {json.dumps(name)}", "# A one-line description."]
    lines.append(f"description = {json.dumps(description, ensure_ascii=False)}")
    if like is None:
        (mass,) = profile_keys(Whole)
        lines += [_about(mass), f'mass_kg = "{UNFILLED}"', f"# {SUSPENSION}", f'suspension = "{UNFILLED}"']
    table = ""
    for key in keys:
        before, (table, _, short) = table, key.name.rpartition(".")
        lines += ["", f"[{table}]"] * (table != before)
        lines += [_about(key), f"{short} = {json.dumps(values[key.name])}"]
    return "\n".join(lines) + "\n"


def _about(key: Declared) -> str:
    """Return the comment above a value."""
    what = key.setting.help.replace("`", "") if key.setting else ""
    return f"# {what[0].upper()}{what[1:]} ({allowed_values(key.kind, key.setting)})."


def find_calibration(vehicle: str | Path, file: Path | None = None, tile_size: float = 3.0) -> Calibration:
    """Find the calibration of a vehicle, an included one for tiles of ``tile_size`` (3, 5 or 6 m).

    ``vehicle``: name of an included vehicle, or a TOML file, whose calibration is the JSON file of the same name beside
    it. If there is none and the profile equals that of an included vehicle, the calibration of that is used. Name,
    description and weights are those of the TOML file. ``file``: a calibration file; ``vehicle`` is then ignored.

    Raises UsageError if there is no vehicle of that name, or no such file; BadInputError if profile or calibration
    cannot be read, or are of different vehicles.
    """
    if file is not None:
        return _checked(Calibration.load(file), str(file))
    profile = Vehicle.load(vehicle)
    if str(vehicle) in shipped_calibrations():
        return Calibration.shipped(str(vehicle), tile_size)
    path = Path(vehicle)
    beside = path.with_suffix(".json")
    again = f"bumpymap calibrate --vehicle {shlex.quote(str(path))} --out {shlex.quote(str(beside))}"
    if beside.exists():
        calibration = _checked(Calibration.load(beside), str(beside))
        try:
            return calibration.with_preferences(profile.to_dict(), str(beside))
        except BadInputError as error:
            raise BadInputError(f"{error}. Calibrate for the vehicle of {path}: {again} --overwrite") from error
    for name in shipped_calibrations():
        try:
            return Calibration.shipped(name, tile_size).with_preferences(profile.to_dict(), name)
        except BadInputError:  # another vehicle
            continue
    raise BadInputError(
        f"there is no calibration of {path}: {beside} does not exist. Make it: {again} (--quick makes a rough one)"
    )


def map_calibration(
    manifest: Mapping[str, Any], tile_size: float, file: Path | None = None, *, follow_paths: bool = False
) -> Calibration:
    """Find the calibration that a map was made with, at the speed of the map.

    ``manifest``: the content of its run.json; ``tile_size``: m; ``file``: the calibration, None: an included one with
    the preferences in run.json, or with ``follow_paths`` where run.json says that it was: a folder that somebody else
    made may name any path.

    Raises UsageError: it is not found; BadInputError: it is another one, or cannot be read.
    """
    about, wanted = manifest["vehicle"], manifest.get("calibration", {}).get("id", "")
    settings = manifest.get("settings", {}) if follow_paths else {}
    named, vehicle = file or settings.get("calibration"), str(settings.get("vehicle") or about["name"])
    speed = float(about["speed_mps"]) if "drives_mps" in about else None
    if not named:
        preferences = manifest.get("calibration", {}).get("preferences", {})
        for name in sorted(shipped_calibrations(), key=lambda name: name != about["name"]):
            own = Calibration.shipped(name, tile_size)
            with suppress(BadInputError, UsageError, TypeError):  # another vehicle, or preferences that make no sense
                profile = {**own.vehicle, **preferences}
                Vehicle.from_dict(profile, name)
                included = at_speed(own.with_preferences(profile, name), speed)
                if included.id == wanted:
                    return included
    try:
        found = at_speed(find_calibration(vehicle, Path(named) if named else None, tile_size), speed)
    except (BadInputError, UsageError) as error:
        if file is not None:
            raise
        raise UsageError(
            f"the calibration {wanted} of the map is not found ({error}). Give its file with `calibration`"
        ) from error
    if found.id != wanted:
        raise BadInputError(
            f"the map was made with the calibration {wanted} of {about['name']}; {named or vehicle} holds {found.id}. "
            "Give the file of the map's own with `calibration`, or map the survey again"
        )
    return found


def _checked(calibration: Calibration, origin: str) -> Calibration:
    """Check the stored vehicle like a profile before it is used."""
    Vehicle.from_dict(calibration.vehicle, f"{origin}, vehicle")
    return calibration
