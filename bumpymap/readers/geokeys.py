"""CRS of a LAS file: its WKT and GeoTIFF records, and which of them counts.

GeoTIFF 1.1 (OGC 19-008r4) keys: 1024 model type (1 projected, 2 geographic, 3 geocentric), 2048 geodetic CRS, 3072
projected CRS, 3076 unit of easting and northing, 4096 vertical CRS, 4099 unit of height. 32767 means "user-defined".
"""

from dataclasses import replace

from pyproj import CRS

from bumpymap.core import (
    CrsStatement,
    crs_from_epsg,
    describe_crs,
    horizontal_of,
    linear_unit,
    same_crs,
    statement_from_wkt,
    vertical_of,
    with_vertical,
)

__all__ = ["statement_from_geokeys", "statement_of_las"]

_MODEL, _GEODETIC, _PROJECTED, _LINEAR, _VERTICAL, _VERTICAL_UNIT = 1024, 2048, 3072, 3076, 4096, 4099
_USER_DEFINED = 32767
_SAME_FOOT = 1e-5
"""Relative; the two feet differ by 2e-6, and files mix them up without harm."""


def statement_of_las(wkt: str | None, geokeys: dict[int, int] | None, citation: str, *, wkt_bit: bool) -> CrsStatement:
    """Choose between the two records that a LAS header may hold.

    Parameters
    ----------
    wkt : str or None
        Text of the OGC WKT record.
    geokeys : dict of int to int or None
        GeoTIFF keys whose value stands in the directory itself.
    citation : str
        Text that goes with the keys, for messages.
    wkt_bit : bool
        Bit 4 of the global encoding. LAS 1.4 R15, 2.6.1: set, the WKT record counts; not set, the GeoTIFF keys.

    Returns
    -------
    CrsStatement
        Where only one record is there it counts, whatever the bit; where the keys count but cannot be worked out and
        the WKT can, the WKT counts, with a note.
    """
    from_wkt = statement_from_wkt(wkt) if wkt else None
    from_keys = statement_from_geokeys(geokeys, citation) if geokeys else None
    if from_wkt is None or from_keys is None:
        return from_wkt or from_keys or CrsStatement()
    if not wkt_bit and from_keys.crs is None and from_wkt.crs is not None:
        note = "its GeoTIFF keys cannot be worked out; the CRS was taken from its WKT record"
        return CrsStatement(from_wkt.crs, notes=(note,))
    chosen, other = (from_wkt, from_keys) if wkt_bit else (from_keys, from_wkt)
    chosen = _with_height_unit(chosen, other)
    if chosen.crs is None or other.crs is None:
        return chosen
    ours, theirs = (horizontal_of(crs) or crs for crs in (chosen.crs, other.crs))
    if same_crs(ours, theirs):
        return _with_vertical_crs(chosen, ours, other.crs)
    names = ("WKT record", "GeoTIFF keys") if wkt_bit else ("GeoTIFF keys", "WKT record")
    note = f"its {names[0]} ({chosen.crs.name}) counts; its {names[1]} ({other.crs.name}) is spelled differently"
    return CrsStatement(
        chosen.crs, chosen.metres_per_unit, chosen.metres_per_unit_z, chosen.trouble, (*chosen.notes, note)
    )


def _with_vertical_crs(chosen: CrsStatement, horizontal: CRS, other: CRS) -> CrsStatement:
    """Take the vertical CRS from the record that does not count, where only that one states it."""
    vertical = vertical_of(other)
    if vertical is None or chosen.crs is None or chosen.crs.is_compound:
        return chosen
    note = f"only one of its two CRS records states a vertical CRS ({describe_crs(vertical)}); it is believed"
    return replace(chosen, crs=with_vertical(horizontal, vertical), notes=(*chosen.notes, note))


def _with_height_unit(chosen: CrsStatement, other: CrsStatement) -> CrsStatement:
    """Take the unit of height from the record that does not count, where only that one states it."""
    if _height_unit(chosen) is not None or _height_unit(other) is None:
        return chosen
    note = f"only one of its two CRS records states a unit of height ({_height_unit(other):g} m); it is believed"
    return replace(chosen, metres_per_unit_z=_height_unit(other), notes=(*chosen.notes, note))


def _height_unit(statement: CrsStatement) -> float | None:
    axes = statement.crs.axis_info if statement.crs is not None else []
    own = axes[2].unit_conversion_factor if len(axes) > 2 else None
    return statement.metres_per_unit_z or own


def statement_from_geokeys(keys: dict[int, int], citation: str) -> CrsStatement:
    """Work GeoTIFF keys out: coded CRS and units; a user-defined projection gives its units and a note."""
    unit, trouble = _unit(keys, _LINEAR, "easting and northing")
    vertical = _vertical_crs(keys)
    own = None if vertical is None else vertical.axis_info[0].unit_conversion_factor
    unit_z = linear_unit(keys.get(_VERTICAL_UNIT, 0)) or own
    if trouble:
        return CrsStatement(trouble=trouble)
    code = keys.get(_PROJECTED, 0)
    if 0 < code < _USER_DEFINED:
        return _coded(code, unit, unit_z, vertical)
    if keys.get(_MODEL) in {2, 3}:
        coded = keys.get(_GEODETIC, 0)
        known = crs_from_epsg(coded) if 0 < coded < _USER_DEFINED else None
        return CrsStatement(known or crs_from_epsg(4326 if keys[_MODEL] == 2 else 4978))
    notes: tuple[str, ...] = ()
    if keys.get(_MODEL) == 1 or code == _USER_DEFINED:
        named = f" ('{citation}')" if citation else ""
        notes = (f"its GeoTIFF keys describe a CRS without a code{named}; pass `crs` to place it on Earth",)
    return CrsStatement(None, unit, unit_z, notes=notes)


def _coded(code: int, unit: float | None, unit_z: float | None, vertical: CRS | None) -> CrsStatement:
    crs = crs_from_epsg(code)
    if crs is None:
        return CrsStatement(trouble=f"its GeoTIFF keys name EPSG:{code}, which PROJ does not know")
    own = crs.axis_info[0].unit_conversion_factor
    if unit is not None and crs.is_projected and abs(unit / own - 1) > _SAME_FOOT:
        return CrsStatement(
            trouble=f"its GeoTIFF keys name EPSG:{code}, whose unit is {own:g} m, and a unit of {unit:g} m"
        )
    if vertical is not None and crs.is_projected:
        crs = with_vertical(crs, vertical)
    return CrsStatement(crs, metres_per_unit_z=unit_z)


def _unit(keys: dict[int, int], key: int, what: str) -> tuple[float | None, str]:
    code = keys.get(key, 0)
    if code in {0, _USER_DEFINED}:
        return None, ""
    unit = linear_unit(code)
    return unit, "" if unit else f"its GeoTIFF keys give {code} as the unit of {what}, which is no unit of length"


def _vertical_crs(keys: dict[int, int]) -> CRS | None:
    code = keys.get(_VERTICAL, 0)
    crs = crs_from_epsg(code) if 0 < code < _USER_DEFINED else None
    return crs if crs is not None and crs.is_vertical else None
