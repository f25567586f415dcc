"""Names with units of the fields of vector files, for QGIS and pages, and the sentences of its map tips."""

from collections.abc import Iterable, Mapping
from functools import cache

from bumpymap.core import BANDS, CHANGE_KINDS, CLASS_NAMES
from bumpymap.layers import MapFile


def quoted(text: str) -> str:
    """Return a text in an expression of QGIS."""
    return "'" + text.replace("\\", r"\\").replace("'", "''") + "'"


def _pixel(band: int, layer: str = "@layer") -> str:
    """Return an expression for the value under the pointer; QGIS has map tips of rasters from 3.32 on."""
    return f"raster_value({layer}, {band}, @layer_cursor_point)"


def _number(value: str, decimals: int, unit: str = "") -> str:
    shown = f"coalesce(format_number({value}, {decimals}), 'unknown')"
    return f"{shown} || ' {unit}'" if unit else shown


def _field(name: str, decimals: int, unit: str = "") -> str:
    return _number(f'"{name}"', decimals, unit)


def _escaped(name: str) -> str:
    """Return an expression for a field with any text: map tips are HTML."""
    return f"replace(replace(\"{name}\", '&', '&amp;'), '<', '&lt;')"


def value_tip(name: str, unit: str = "", band: int = 1) -> str:
    """Return an expression for the number under the pointer in a raster, after its name."""
    return f"{quoted(name + ' ')} || {_number(_pixel(band), 2, unit)}"


def code_tip(names: Iterable[tuple[int, str]], band: int = 1) -> str:
    """Return an expression for the name of the code under the pointer in a raster."""
    return f"CASE {' '.join(f'WHEN {_pixel(band)} = {code} THEN {quoted(name)}' for code, name in names)} END"


_NAMED = f"array_get(array({', '.join(map(quoted, CLASS_NAMES))}), {{}})"


def _ride(values: Mapping[str, str], class_name: str, crossed: str, end: str) -> str:
    """Return an expression for a ride in a sentence, from expressions for C_r and its interval, and for the rest."""
    c_r, low, high = (_number(values[name], 2) for name in ("c_r", "c_r_low", "c_r_high"))
    return (
        f"'C_r ' || {c_r} || ' rad/m (' || {low} || ' to ' || {high} || '): ' || {class_name} || "
        f"if({crossed}, '; can be crossed', '; cannot be crossed') || {end}"
    )


def ride_tip(limits: Iterable[float], layer: str = "@layer") -> str:
    """Return an expression for the ride under the pointer in roughness.tif.

    ``limits`` of the classes, rad/m; ``layer``: expression for that layer, if the tip is of another one.
    """
    band = {one.name: _pixel(number, layer) for number, one in enumerate(BANDS, 1)}
    code = " + ".join(f"if({band['c_r']} < {limit:.9g}, 0, 1)" for limit in limits)
    sentence = _ride(band, _NAMED.format(code), f"{band['passable']} = 1", _slope(band["slope"]))
    return f"if({band['c_r']} IS NULL, 'not known', {sentence})"


def _slope(value: str) -> str:
    return f"'; slope ' || {_number(value, 0, 'deg')}"


_RIDE = {name: f'"{name}"' for name in ("c_r", "c_r_low", "c_r_high")}
_AREA = f"'; ' || {_field('area_m2', 0, 'm2')}"
_BY_REGION = _ride(_RIDE, '"class_name"', '"passable"', _AREA)
_BY_TILE = _ride(
    _RIDE, _NAMED.format('"class"'), '"passable"', "coalesce(': ' || \"barred\", '') || " + _slope('"slope"')
)
_REGION_TIP = f'if("class" IS NULL, \'not known: \' || "reason" || {_AREA}, {_BY_REGION})'
_LENGTHS = f"{_field('length_m', 0, 'm')} || ', costs ' || {_field('cost_m', 0, 'm')}"
_WAY = f"{_LENGTHS} || '; C_r ' || {_field('c_r_mean', 2, 'rad/m')}"
TIPS = {
    MapFile.TILES.value: f'if("class" IS NULL, \'not known: \' || "reason_text", {_BY_TILE})',
    MapFile.REGIONS.value: _REGION_TIP,
    MapFile.REGIONS_IN_CRS.value: _REGION_TIP,
    "change.geojson": f"\"kind\" || '; height ' || {_field('d_height', 2, 'm')} || '; C_r from ' || "
    f"{_field('c_r_before', 2)} || ' to ' || {_field('c_r_after', 2, 'rad/m')} || {_AREA}",
    "check.geojson": f"{_escaped('drive')} || ': measured ' || {_field('measured', 2)} || ', map ' || "
    f"{_field('c_r', 2, 'rad/m')} || ': ' || \"off\"",
    "route.geojson": f"{_escaped('name')} || if(\"role\" IS NULL, ': ' || {_WAY}, '')",
}
"""Expressions of QGIS by file: a sentence on a feature."""


def _with_ends(name: str, text: str) -> dict[str, str]:
    return {
        name: f"{text} (rad/m)",
        f"{name}_low": f"{text}, lower end of its 80 % interval (rad/m)",
        f"{name}_high": f"{text}, upper end of its 80 % interval (rad/m)",
    }


_BANDS = {band.name: f"{band.description} ({band.unit})" if band.unit else band.description for band in BANDS}
_REGIONS = {
    "region": "number of the region",
    "class": "class: 0 (smoothest) to 3 (roughest)",
    "class_name": "class in words",
    "reason": "why it has no class",
    "c_r_basis": "drives whose mean c_r is: all, or those that get through",
    "hazard": "failures per metre driven (1/m)",
    "cost": "cost of a metre, in metres of level road (m/m)",
    "area_m2": "area (m2)",
    "tiles": "number of tiles",
} | {name: _BANDS[name] for name in ("passable", "c_r", "c_r_low", "c_r_high", "p_fail", "zone") if name in _BANDS}
_FIELDS: dict[str, dict[str, str]] = {
    MapFile.REGIONS.value: _REGIONS,
    MapFile.REGIONS_IN_CRS.value: _REGIONS,
    "change.geojson": {
        "tiles": "number of tiles",
        "area_m2": "area (m2)",
        "kind": "what has changed in most tiles",
        **{kind.replace(",", "").replace(" ", "_"): f"{kind} (tiles)" for kind in CHANGE_KINDS[1:]},
        "d_height": "mean height, after minus before (m)",
        "d_height_lowest": "height, after minus before, of the lowest tile (m)",
        "d_height_highest": "height, after minus before, of the highest tile (m)",
        "d_largest": "largest difference that two neighbouring pixels reach (m)",
        "volume_m3": "volume heaped up (m3)",
        "volume_sd_m3": "standard deviation of that (m3)",
        "d_c_r": "ride cost, after minus before (rad/m)",
        "c_r_before": "ride cost before (rad/m)",
        "c_r_after": "ride cost after (rad/m)",
        "z_height": "evidence for another height, in standard errors",
        "z_shape": "evidence for another shape, in standard errors",
        "z_c_r": "evidence for another ride cost, in standard errors",
        "class_before": "class of most tiles before: 0 (smoothest) to 3 (roughest)",
        "class_after": "class of most tiles after: 0 (smoothest) to 3 (roughest)",
        "passable_lost": "tiles that can no longer be crossed",
        "passable_won": "tiles that can be crossed now",
    },
    "check.geojson": {
        "drive": "name of the drive",
        "start_s": "start of the stretch (s)",
        "end_s": "end of the stretch (s)",
        "way_m": "length of the stretch (m)",
        "speed_mps": "mean speed (m/s)",
        "measured": "ride cost of the drive (rad/m)",
        "measured_sd": "standard error of that (rad/m)",
        **_with_ends("c_r", "ride cost of the map"),
        "place_sd": "spread of the map's ride cost over where the vehicle may have been (rad/m)",
        **_with_ends("c_r_line", "ride cost of the driven line on the map"),
        "ratio": "map over drive",
        "off": "how far the map is off",
        "explained": "whether errors explain the difference",
        "class": "class of the map: 0 (smoothest) to 3 (roughest)",
        "class_name": "class of the map in words",
        "measured_class": "class of the drive: 0 (smoothest) to 3 (roughest)",
        "measured_class_name": "class of the drive in words",
    },
    "route.geojson": {
        "name": "name",
        "role": "start, via or goal",
        "vehicle": "vehicle",
        "length_m": "length (m)",
        "straight_m": "straight lines between the stops (m)",
        "detour": "length over the straight lines",
        "cost_m": "cost, in metres of level road (m)",
        **_with_ends("c_r_mean", "mean ride cost of the tiles"),
        **_with_ends("c_r_max", "ride cost of the worst tile"),
        **_with_ends("c_r_line", "mean ride cost of the line itself"),
        "p_arrives": "probability to arrive",
        "p_arrives_note": "on that probability",
        "p_fail_max": "highest share of drives that fail",
        "unknown_m": "length on unknown ground (m)",
        "obstacle_m": "length through obstacles (m)",
        "climb_m": "climb (m)",
        "descent_m": "descent (m)",
        "seconds": "time (s)",
        "tight_turns_deg": "turns without room (deg)",
        "points_per_m2": "points per square metre (1/m2)",
        "smallest_object_m": "smallest object that would have been seen (m)",
        "smallest_step_m": "lowest step that would have been seen (m)",
        "seen": "what the survey does not show",
        "risk_m": "detour that a certain failure is worth (m)",
        "why": "why the way leaves the straight line",
    },
}


@cache
def field_names(file: str) -> dict[str, str]:
    """Return a name with unit for each field of a vector file of bumpymap, by the field."""
    if file != MapFile.TILES:
        return _FIELDS[file]
    from bumpymap.layers import tile_fields

    named = {}
    for field in tile_fields(1, has_source=True):
        text, unit = (field.metadata.get(key, b"").decode() for key in (b"description", b"unit"))
        named[field.name] = f"{text} ({unit})" if unit else text
    return named
