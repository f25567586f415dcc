"""Determine the CRS and units of a file, and of the files of a run.

A ``CrsStatement`` holds what a file states. ``--crs`` supplies what it does not state, ``force_crs`` overrides it;
``--xy-unit`` supplies the unit where no CRS states it, and ``--z-unit`` overrides every unit of height. The result
keeps the vertical CRS.
Degrees and Earth-centred coordinates are refused with a message that shows the command to reproject the file.
"""

import logging
import math
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from pyproj import CRS, Proj, Transformer, get_units_map
from pyproj.crs import CompoundCRS
from pyproj.exceptions import CRSError, ProjError

from bumpymap.core.config import LengthUnit
from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.core.types import Georeference

_ZONE = "where ZZ is the UTM zone, (longitude + 180) / 6 + 1 (327ZZ in the south)"
SAY_CRS = "Say which CRS the coordinates are in with `crs`, such as `crs='EPSG:32614'`"
FORCE_CRS = "Override it with `force_crs`, such as `force_crs='EPSG:32614'`"
"""For files that state no CRS, and for those that state a wrong one."""


@dataclass(frozen=True, slots=True)
class Place:
    """A file and the centre of its extent in the file's units (None if unknown), for messages."""

    path: Path
    middle: tuple[float, float, float] | None = None


def describe_crs(crs: CRS) -> str:
    """Return name and code, such as ``WGS 84 / UTM zone 14N (EPSG:32614)``; or ``(EPSG:32614+5703)`` if compound."""
    parts = crs.sub_crs_list if crs.is_compound and crs.to_epsg() is None else [crs]
    codes = [part.to_epsg() for part in parts]
    code = "" if None in codes else "+".join(map(str, codes))
    return f"{crs.name} (EPSG:{code})" if code else crs.name


def refuse_unprojected(place: Place, crs: CRS, *, from_user: bool) -> None:
    """Raise BadInputError unless the CRS is a projected or a local (engineering) one.

    ``from_user``: whether the CRS came from ``--crs``, so that the command that reprojects must name it too. Raises
    BadInputError: the CRS is geographic or geocentric (the message shows the command that reprojects the file), or
    vertical only.
    """
    base = crs.sub_crs_list[0] if crs.is_compound else crs
    if base.is_projected or base.type_name == "Engineering CRS":
        return
    if base.is_vertical:
        raise BadInputError(f"{describe_crs(crs)} is a vertical CRS and does not locate {place.path}. {SAY_CRS}")
    what = "Earth-centred coordinates" if base.is_geocentric else "degrees"
    longitude_latitude = _longitude_latitude(place, base)
    if longitude_latitude is None and place.middle is not None:
        shown = ", ".join(f"{value:.10g}" for value in place.middle[:2])
        raise BadInputError(
            f"{place.path} is stated to be in {what} ({describe_crs(crs)}), but its centre lies at {shown}, which is "
            f"not such a place. {FORCE_CRS}"
        )
    source = crs.to_string() if from_user else None
    raise BadInputError(
        f"{place.path} is in {what} ({describe_crs(crs)}); bumpymap measures in metres and needs a projected CRS. "
        "Reproject it first:",
        f"  {reproject_command(place.path, longitude_latitude, source)}",
        *([] if longitude_latitude else [_ZONE]),
    )


def _longitude_latitude(place: Place, crs: CRS) -> tuple[float, float] | None:
    """Return the centre of the file, degrees; None if it is unknown or not a location on Earth."""
    if place.middle is None:
        return None
    longitude, latitude, height = place.middle
    if crs.is_geocentric:
        longitude, latitude, _ = Transformer.from_crs(crs, 4979, always_xy=True).transform(longitude, latitude, height)
    inside = abs(longitude) <= 360 and abs(latitude) <= 90
    return (longitude, latitude) if inside else None


def utm_epsg(longitude: float, latitude: float) -> int:
    """Return the EPSG code of the WGS 84 / UTM zone of a location, or of polar stereographic beyond 84 N or 80 S.

    Examples
    --------
    >>> utm_epsg(-99.1, 19.4), utm_epsg(-58.4, -34.6), utm_epsg(180.0, 10.0)
    (32614, 32721, 32601)
    """
    if latitude >= 84:
        return 5041
    if latitude < -80:
        return 5042
    zone = int((longitude + 180) // 6) % 60 + 1
    return (32600 if latitude >= 0 else 32700) + zone


def reproject_command(path: Path, longitude_latitude: tuple[float, float] | None, source: str | None) -> str:
    """Return the command that reprojects a file from degrees to metres: of PDAL, with a resolution of 1 mm, or of GDAL.

    ``longitude_latitude`` (float, float) or None: location of the file, degrees; None: the user must fill in the UTM
    zone; ``source``: CRS of the file, if the file itself does not state it.
    """
    target = "EPSG:326ZZ" if longitude_latitude is None else f"EPSG:{utm_epsg(*longitude_latitude)}"
    if path.suffix.lower() in {".tif", ".tiff"}:
        words = ["gdalwarp", "-r", "bilinear", "-t_srs", target, *(["-s_srs", source] if source else [])]
        return shlex.join([*words, str(path), f"{path.stem}_metres.tif"])
    words = ["pdal", "translate", shlex.quote(str(path)), shlex.quote(f"{Path(path).name.split('.')[0]}_metres.laz")]
    words += ["reprojection", f"--filters.reprojection.out_srs={target}"]
    words += [f"--filters.reprojection.in_srs={shlex.quote(source)}"] if source else []
    words += [f"--writers.las.scale_{axis}=0.001 --writers.las.offset_{axis}=auto" for axis in "xyz"]
    return " ".join(words)


def vertical_of(crs: CRS) -> CRS | None:
    """Return the vertical part of a compound CRS; None if there is none, or if it counts depths."""
    if not crs.is_compound:
        return None
    vertical = crs.sub_crs_list[-1]
    if vertical.is_bound and vertical.source_crs is not None:
        vertical = vertical.source_crs  # a grid to the ellipsoid does not change the datum
    axes = vertical.axis_info
    return vertical if vertical.is_vertical and len(axes) == 1 and axes[0].direction == "up" else None


def in_metres(vertical: CRS) -> bool:
    """Return whether the unit of a vertical CRS is the metre."""
    return bool(vertical.axis_info[0].unit_conversion_factor == 1.0)


def same_datum(first: CRS, second: CRS) -> bool:
    """Return whether two vertical CRS have the same datum; their units may differ."""
    if first == second:
        return True
    one, other = first.datum, second.datum
    if one is None or other is None:
        return False
    # Spellings of names vary.
    plain = ["".join(filter(str.isalnum, datum.name.casefold())) for datum in (one, other)]
    return one == other or plain[0] == plain[1]


def with_vertical(horizontal: CRS, vertical: CRS, stated: CRS | None = None) -> CRS:
    """Join two CRS; return ``stated`` if it is made of these two, to keep its name and code."""
    if stated is not None and stated.is_compound and stated.sub_crs_list == [horizontal, vertical]:
        return stated
    joined = CompoundCRS(f"{horizontal.name} + {vertical.name}", [horizontal, vertical])
    return CRS.from_json_dict(joined.to_json_dict())  # a CompoundCRS has no to_2d


_log = logging.getLogger(__name__)

_US_FOOT = 1200 / 3937
"""US survey foot, m (exact by definition)."""
_UNITS = {1.0: "metre", 0.3048: "foot", _US_FOOT: "US survey foot"}
_GIVEN_UNITS = {"m": 1.0, "ft": 0.3048, "us-ft": _US_FOOT}
_SCALE_TOLERANCE = 0.01
"""Lengths in a CRS may differ from those on the ground by this share: UTM's by 0.1 %, those far off a zone by more."""
_STRINGS = re.compile('"((?:[^"]|"")*)"')
_FILE_PARAMETER = re.compile(r"(?:grids|init|file|model|catalog)\s*=")
_FILE_VALUE = re.compile(r'PARAMETERFILE\s*[\[(]\s*"(?:[^"]|"")*"\s*,\s*"((?:[^"]|"")*)"|"value"\s*:\s*"([^"]*)"')
_ELSEWHERE = re.compile(r"[/\\~]")
_LEAST_UNIT, _LARGEST_UNIT = 1e-6, 1e6
"""Allowed range of units, m; those of EPSG lie well inside, from the millimetre to the nautical mile."""


@dataclass(frozen=True, slots=True)
class GivenCrs:
    """CRS and units that the user gives."""

    crs: str | None = None
    """CRS of files that state none; any that PROJ understands, such as ``EPSG:32614``."""
    force_crs: str | None = None
    """CRS of all files, whatever they state."""
    must_agree: bool = False
    """True: a file that states another CRS than ``crs`` is refused; else its own is used, with a note."""
    xy_unit: LengthUnit | None = None
    """Unit of easting and northing of files without a CRS; None: that of the file, else metres."""
    z_unit: LengthUnit | None = None
    """Unit of heights; None: that of the file."""


@dataclass(frozen=True, slots=True)
class CrsStatement:
    """CRS and units that a file states."""

    crs: CRS | None = None
    """As stated, with its vertical part; None if the file states none, or one that cannot be parsed."""
    metres_per_unit: float | None = None
    """Horizontal unit, if it is stated separately from the CRS."""
    metres_per_unit_z: float | None = None
    """Unit of height, if it is stated separately from the CRS."""
    trouble: str = ""
    """Why the statement is not usable; empty if it is."""
    notes: tuple[str, ...] = ()


class _HasGeoreference(Protocol):
    @property
    def path(self) -> Path: ...
    @property
    def georeference(self) -> Georeference: ...


def stated_crs(text: str) -> CRS:
    """Parse a CRS that a file or a record states.

    PROJ would open the grid files that a CRS names, wherever they are. Those in its own folders have no path. Raises
    pyproj.exceptions.CRSError: PROJ does not know it, or it names a file by its path or a URL.
    """
    is_wkt = re.match(r"\s*\w+\s*[\[(]", text)
    parts = _STRINGS.findall(text) if is_wkt else [text]
    values = "".join(map("".join, _FILE_VALUE.findall(text)))
    by_parameter = any(_FILE_PARAMETER.search(part.lower()) and _ELSEWHERE.search(part) for part in parts)
    if by_parameter or _ELSEWHERE.search(values):
        raise CRSError("it names a file by its path. Put grids in a folder of PROJ_DATA, and name them without path")
    if is_wkt and "\u201c" in text:  # quotes too, for PROJ
        raise CRSError("it has printed quotation marks")
    return CRS.from_user_input(text)


def parse_crs(text: str, name: str = "crs") -> CRS:
    """Parse the value of ``--crs``, or of the setting ``name``. Raises UsageError if `stated_crs` refuses it."""
    try:
        return stated_crs(text)
    except CRSError as error:
        if "by its path" in str(error):
            raise UsageError(f"`{name}='{text}'` cannot be used: {error}") from error
        raise UsageError(
            f"`{name}='{text}'` is not a coordinate reference system. Give a code such as EPSG:32614, a PROJ string or "
            "WKT"
        ) from error


def statement_from_wkt(text: str) -> CrsStatement:
    """Parse a WKT record; if PROJ cannot, the reason is in ``trouble``."""
    try:
        return CrsStatement(stated_crs(text))
    except CRSError:
        shown = text if len(text) <= 60 else text[:57] + "..."
        return CrsStatement(trouble=f"its WKT record cannot be understood ({shown!r})")


def crs_from_epsg(code: int) -> CRS | None:
    """Return the CRS of an EPSG code; None if PROJ does not know it."""
    try:
        return CRS.from_epsg(code)
    except CRSError:
        return None


def linear_unit(code: int) -> float | None:
    """Return the metres in a unit of length by its EPSG code, such as 9003; None if there is no such unit."""
    for unit in get_units_map(auth_name="EPSG", category="linear").values():
        if unit.code == str(code):
            return _exact(unit.conv_factor)
    return None


def unit_name(metres_per_unit: float) -> str:
    """Return the name of a unit for messages."""
    return _UNITS.get(metres_per_unit, f"unit of {metres_per_unit:g} m")


def georeference(place: Place, statement: CrsStatement, given: GivenCrs) -> tuple[Georeference, tuple[str, ...]]:
    """Determine CRS and units of one file.

    ``statement``: what the file states. Returns the georeference, whose ``crs`` is the horizontal CRS, or a compound
    CRS if a vertical one is stated too; None if it is unknown or a local (engineering) CRS; and notes for the user.
    Raises BadInputError: the file's statement is not usable and no CRS was given, or the CRS is not projected;
    UsageError: what was given is not a CRS, or not that of the file although it must be, or contradicts the unit of the
    CRS.
    """
    user, notes = _from_user(place, statement, given)
    if user is None and statement.trouble:
        raise BadInputError(f"the CRS of {place.path} is unclear: {statement.trouble}. {SAY_CRS}")
    crs = user or statement.crs
    if crs is not None:
        refuse_unprojected(place, crs, from_user=user is not None)
        _refuse_units(place, crs, from_user=user is not None)
    stated = _horizontal_unit(place, crs, statement, given.xy_unit)
    unit = stated or 1.0
    of_file = _unit(user, 2) or _vertical_of_file(statement, unit) or unit
    unit_z = _GIVEN_UNITS[given.z_unit] if given.z_unit else of_file
    if not math.isclose(unit, unit_z, rel_tol=1e-5):
        notes.append(f"heights are in another unit ({unit_name(unit_z)}) than easting and northing ({unit_name(unit)})")
    horizontal = horizontal_of(crs) if crs is not None else None
    if horizontal is None and crs is not None:
        notes.append(f"its CRS '{crs.name}' is a local one: bumpymap treats it as no CRS")
    elif horizontal is not None:
        notes += place_notes(place, horizontal)
    vertical = None if horizontal is None else _vertical_crs(user, statement.crs)
    if horizontal is None or vertical is None:
        return Georeference(horizontal, unit, unit_z, assumed=stated is None), tuple(notes)
    if not in_metres(vertical):
        notes.append(f"{describe_crs(vertical)} is not in metres, as heights in the layers are: they do not carry it")
    return Georeference(with_vertical(horizontal, vertical, crs), unit, unit_z), tuple(notes)


def _vertical_crs(user: CRS | None, own: CRS | None) -> CRS | None:
    """Return the vertical part of the given CRS, or that of the file if it has none and agrees with the file."""
    vertical = None if user is None else vertical_of(user)
    if own is None or vertical is not None:
        return vertical
    return vertical_of(own) if user is None or _same_horizontal(user, own) else None


def _refuse_units(place: Place, crs: CRS, *, from_user: bool) -> None:
    """Refuse a projected CRS with an implausible unit: PROJ accepts any number in a text."""
    factors = [axis.unit_conversion_factor for axis in crs.axis_info]
    wrong = next((factor for factor in factors if not _LEAST_UNIT <= factor <= _LARGEST_UNIT), None)
    if wrong is None:
        return
    if from_user:
        raise UsageError(
            f"the given CRS, {crs.name}, has an invalid unit of {wrong:g} m. Give a code such as EPSG:32614, a PROJ "
            "string or WKT with units"
        )
    raise BadInputError(
        f"the CRS of {place.path} is unclear: {describe_crs(crs)} has an invalid unit of {wrong:g} m. {FORCE_CRS}"
    )


def _from_user(place: Place, statement: CrsStatement, given: GivenCrs) -> tuple[CRS | None, list[str]]:
    """Return what the user's CRS supplies or overrides, None if the file's is used; with notes."""
    own, notes = statement.crs, list(statement.notes)
    if given.force_crs is not None:
        user = parse_crs(given.force_crs, "force_crs")
        return user, _set_aside(user, statement, "force_crs")
    if given.crs is None:
        return None, notes
    user = parse_crs(given.crs)
    base = own.sub_crs_list[0] if own is not None and own.is_compound else own
    if own is None or base is None or base.is_vertical or base.type_name == "Engineering CRS":  # it locates nothing
        return user, _set_aside(user, statement, "crs")
    if _same_horizontal(user, own):
        heights, theirs = vertical_of(user), vertical_of(own)
        if heights is None or (theirs is not None and heights == theirs):
            return None, notes
        if theirs is None and len(own.axis_info) < 3:  # the file states no heights, so they are supplied
            return user, notes
    what = f"its CRS is {describe_crs(own)}, and `crs='{given.crs}'` is for surveys that have none"
    force = f"pass `force_crs='{given.crs}'` if the file is wrong"
    if given.must_agree:
        raise UsageError(f"{place.path}: {what}. Leave `crs` out, or {force}")
    return None, [*notes, f"{what}: its own is used; {force}"]


def _set_aside(user: CRS, statement: CrsStatement, name: str) -> list[str]:
    """Return a note if a file states something else than the CRS that is used."""
    if statement.trouble:
        return [f"its own CRS was set aside for `{name}`: {statement.trouble}"]
    own = statement.crs
    if own is None or _same_horizontal(user, own):
        return []
    return [f"the file says its CRS is {describe_crs(own)}; `{name}` says {describe_crs(user)}, and wins"]


def _same_horizontal(first: CRS, second: CRS) -> bool:
    one, other = horizontal_of(first), horizontal_of(second)
    return one is not None and other is not None and same_crs(one, other)


def same_crs(first: CRS, second: CRS) -> bool:
    """Return whether two horizontal CRS are the same, even if they are written differently."""
    if first == second or first.equals(second, ignore_axis_order=True):
        return True
    stated, matched = _code(first), first.to_epsg()
    return (stated != "" and stated == _code(second)) or (matched is not None and matched == second.to_epsg())


def _code(crs: CRS) -> str:
    """Return the code that a CRS itself states, not one that PROJ finds by comparison; empty if it states none."""
    stated = crs.to_json_dict().get("id", {})
    return f"{stated['authority']}:{stated['code']}" if stated else ""


def _exact(factor: float) -> float:
    """Snap a unit that was written with few digits to the known one, so that results are bit-identical."""
    return next((known for known in _UNITS if math.isclose(factor, known, rel_tol=1e-9)), factor)


def _horizontal_unit(place: Place, crs: CRS | None, statement: CrsStatement, given: str | None) -> float | None:
    """Return the unit of easting and northing; None if nothing states it."""
    own = _unit(crs, 0) or statement.metres_per_unit
    if given is None:
        return own
    unit = _GIVEN_UNITS[given]
    if crs is not None and own is not None and horizontal_of(crs) and not math.isclose(own, unit, rel_tol=1e-5):
        raise UsageError(
            f"{place.path}: the unit of its CRS, {describe_crs(crs)}, is the {unit_name(own)}, and `xy_unit='{given}'` "
            "is for surveys without a CRS. Leave it out, or give the right CRS with `force_crs`"
        )
    return own if crs is not None and horizontal_of(crs) else unit


def _vertical_of_file(statement: CrsStatement, unit: float) -> float | None:
    """Return the unit of height that the file states; ignored if the CRS used contradicts its horizontal unit."""
    own = statement.metres_per_unit or _unit(statement.crs, 0)
    denied = own is not None and not math.isclose(own, unit, rel_tol=1e-5)
    stated = None if statement.metres_per_unit_z is None else _exact(statement.metres_per_unit_z)
    return None if denied else stated or _unit(statement.crs, 2)


def _unit(crs: CRS | None, axis: int) -> float | None:
    """Return the unit of an axis, 0 to 2; None if there is none."""
    return None if crs is None or len(crs.axis_info) <= axis else _exact(crs.axis_info[axis].unit_conversion_factor)


def horizontal_of(crs: CRS) -> CRS | None:
    """Return the horizontal part of a CRS; None for a local (engineering) CRS."""
    if crs.is_compound:
        return horizontal_of(crs.sub_crs_list[0])
    if crs.is_bound and crs.source_crs is not None and _code(crs.source_crs):
        # A TOWGS84 clause around a CRS with a code: PROJ knows better transformations to WGS 84.
        return horizontal_of(crs.source_crs)
    if not crs.is_projected:
        return None
    return crs if len(crs.axis_info) == 2 else crs.to_2d()


def place_notes(place: Place, crs: CRS) -> list[str]:
    """Return a note if a horizontal CRS is doubtful for the middle of a file, or its metre is not one on the ground.

    A metre of Web Mercator, for example, is 1.4 m at 45 degrees. Raises BadInputError: the middle is no place on Earth
    in this CRS.
    """
    if place.middle is None:
        return []
    x, y, _ = place.middle
    try:
        proj = Proj(crs)
    except (ProjError, CRSError):
        return [f"{crs.name} has no relation to longitude and latitude here: whether it fits was not checked"]
    try:
        longitude, latitude = proj(x, y, inverse=True, errcheck=True)
        scale = proj.get_factors(longitude, latitude, errcheck=True).meridional_scale
    except (ProjError, CRSError) as error:
        raise BadInputError(
            f"the middle of {place.path}, {x:.10g}, {y:.10g}, is no place on Earth in {describe_crs(crs)}. "
            f"{_other_reading(crs, proj, x, y)}{FORCE_CRS}. If only the extent in the header is wrong, "
            "`trust_points=True` continues with that of the points"
        ) from error
    outside = _degrees_outside(crs, longitude, latitude)
    if outside > _NEAR_DEGREES:
        where = f"its middle, {x:.10g}, {y:.10g}, lies {outside:.1f} degrees outside the area of use of"
        remedy = "If the CRS is wrong, give the right one with `force_crs='EPSG:CODE'`"
        return [f"{where} {describe_crs(crs)}. {_other_reading(crs, proj, x, y)}{remedy}"]
    if abs(scale - 1) <= _SCALE_TOLERANCE:
        return []
    here = f"one metre of {crs.name} is {1 / scale:.3f} m on the ground here: tiles are that much smaller and slopes"
    return [f"{here} steeper than they seem. Reproject to the local UTM zone for a true map"]


_NEAR_DEGREES = 0.5
"""So far beyond the area of use of a CRS nothing is said: surveys cross the borders of zones."""
_READINGS = {
    "Eastings and northings seem to be swapped": ((0.0, 1.0), (1.0, 0.0)),
    "Feet seem to have been read as metres": ((0.3048, 0.0), (0.0, 0.3048)),
    "Metres seem to have been read as feet": ((1 / 0.3048, 0.0), (0.0, 1 / 0.3048)),
}
"""Faults of coordinates, and the matrix that takes them out."""
_LOCAL_FRAME = 10_000.0
"""Coordinates that are smaller than this look like those of a local frame."""


def _degrees_outside(crs: CRS, longitude: float, latitude: float) -> float:
    """Return how far a place lies outside the area of use of a CRS, degrees; 0 inside or if it has none."""
    area = crs.area_of_use
    if area is None:
        return 0.0
    if not (math.isfinite(longitude) and math.isfinite(latitude)):
        return math.inf
    width = (area.east - area.west) % 360.0 or 360.0
    east_of = (longitude - area.west) % 360.0
    aside = 0.0 if east_of <= width else min(east_of - width, 360.0 - east_of)
    return float(max(aside, area.south - latitude, latitude - area.north, 0.0))


def _other_reading(crs: CRS, proj: Proj, x: float, y: float) -> str:
    """Return in a sentence how coordinates would lie in the area of use; empty if nobody knows."""
    if max(abs(x), abs(y)) < _LOCAL_FRAME:
        return "They look like coordinates of a local frame, which map takes with `local=True` and without a CRS. "
    for fault, ((a, b), (c, d)) in _READINGS.items():
        if _degrees_outside(crs, *proj(a * x + b * y, c * x + d * y, inverse=True)) == 0.0:
            return f"{fault}. "
    return ""


def common_georeference(infos: Sequence[_HasGeoreference]) -> Georeference:
    """Return the georeference that all files of a run share.

    Units may differ between files, since each file is converted with its own; those of the first file (by path) are
    returned. If only some files state a vertical CRS, the result has none, and a warning is logged. Raises
    BadInputError: files have different CRS, or only some have one, or their heights refer to different vertical datums;
    the message lists the files.
    """
    ordered = sorted(infos, key=lambda info: str(info.path))
    if not ordered:
        raise BadInputError("no survey was given; name a point cloud file or a folder of them")
    first = ordered[0].georeference
    held = [info.georeference.crs for info in ordered]
    flat = [None if crs is None else horizontal_of(crs) for crs in held]
    known = [crs for crs in flat if crs is not None]
    if len(known) in {0, len(flat)} and all(same_crs(known[0], crs) for crs in known):
        crs = _common_crs(ordered, held)
        return first if crs is held[0] else replace(first, crs=crs)
    advice = (
        f"{SAY_CRS} if that is right for all of them"
        if any(crs is None for crs in held)
        else "Reproject them to one CRS, or map them in separate runs; `force_crs` sets one for all if they are wrong"
    )
    raise BadInputError("the files are not in one CRS:", *_listed(ordered, held), advice)


def _common_crs(ordered: Sequence[_HasGeoreference], held: Sequence[CRS | None]) -> CRS | None:
    """Return the CRS of files whose horizontal CRS agree; it has a vertical part if all of them have one."""
    vertical = [None if crs is None else vertical_of(crs) for crs in held]
    stated = [crs for crs in vertical if crs is not None]
    if not all(same_datum(stated[0], crs) for crs in stated):
        raise BadInputError(
            "the heights of the files are not in one vertical CRS:",
            *_listed(ordered, held),
            "Reproject them to one, or map them in separate runs; `force_crs` with a vertical part, such as "
            "EPSG:32614+5703, sets one for all if the files are wrong",
        )
    if stated and len(stated) < len(held):
        _log.warning(
            "%d of %d files state a vertical CRS (%s), so the layers carry none. `crs` with a vertical part, such as "
            "EPSG:32614+5703, sets one for all",
            len(stated),
            len(held),
            describe_crs(stated[0]),
        )
        return None if held[0] is None else horizontal_of(held[0])
    # Files in metres and in feet of one datum: all heights have been converted to metres.
    metric = (crs for crs, own in zip(held, vertical, strict=True) if own is not None and in_metres(own))
    return next(metric, held[0])


def _listed(ordered: Sequence[_HasGeoreference], held: Sequence[CRS | None]) -> list[str]:
    files = zip(ordered, held, strict=True)
    lines = [f"  {info.path}: {describe_crs(crs) if crs else 'no CRS'}" for info, crs in files]
    return lines if len(lines) <= 20 else [*lines[:20], f"  ... and {len(lines) - 20} more"]
