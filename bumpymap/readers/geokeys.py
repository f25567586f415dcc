"""Read the CRS of a LAS file from its WKT and GeoTIFF records, and choose between them.

GeoTIFF 1.1 (OGC 19-008r4) keys: 1024 model type (1 projected, 2 geographic, 3 geocentric), 2048 geodetic CRS, 3072
projected CRS, 3076 unit of easting and northing, 4096 vertical CRS, 4099 unit of height. 32767 means "user-defined".
"""

from dataclasses import replace

import numpy as np
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
from bumpymap.readers.las_header import RawHeader

__all__ = ["statement_of_las"]

_PROJECTION = b"LASF_Projection"
_MODEL, _GEODETIC, _PROJECTED, _LINEAR, _VERTICAL, _VERTICAL_UNIT = 1024, 2048, 3072, 3076, 4096, 4099
_USER_DEFINED = 32767
_SAME_FOOT = 1e-5
"""Relative tolerance; the two feet differ by 2e-6, and files confuse them."""


def statement_of_las(header: RawHeader) -> CrsStatement:
    """Return what the CRS records of a LAS header state.

    LAS 1.4 R15, 2.6.1: if bit 4 of the global encoding is set, the WKT record is used, otherwise the GeoTIFF keys. If
    there is only one record, it is used whatever the bit. If the keys should be used but cannot be interpreted, the
    WKT record is used, with a note.
    """
    wkt, directory, citation = (header.records.get((_PROJECTION, number), b"") for number in (2112, 34735, 34737))
    from_wkt = statement_from_wkt(_text(wkt)) if _text(wkt) else None
    from_keys = _statement_from_keys(_keys(directory), _text(citation).split("|")[0])
    if from_wkt is None or from_keys is None:
        return from_wkt or from_keys or CrsStatement()
    if not header.wkt_bit and from_keys.crs is None and from_wkt.crs is not None:
        note = "its GeoTIFF keys cannot be interpreted; the CRS was taken from its WKT record"
        return CrsStatement(from_wkt.crs, notes=(note,))
    chosen, other = (from_wkt, from_keys) if header.wkt_bit else (from_keys, from_wkt)
    chosen = _with_height_unit(chosen, other)
    if chosen.crs is None or other.crs is None:
        return chosen
    ours, theirs = (horizontal_of(crs) or crs for crs in (chosen.crs, other.crs))
    if same_crs(ours, theirs):
        return _with_vertical_crs(chosen, ours, other.crs)
    names = ("WKT record", "GeoTIFF keys") if header.wkt_bit else ("GeoTIFF keys", "WKT record")
    note = f"its {names[0]} ({chosen.crs.name}) is used; its {names[1]} ({other.crs.name}) differs"
    return replace(chosen, notes=(*chosen.notes, note))


def _text(data: bytes) -> str:
    """Decode a text record up to the first zero byte."""
    return data.split(b"\0")[0].decode("utf-8", "replace").strip()


def _keys(data: bytes) -> dict[int, int]:
    """Read the GeoTIFF key directory (16-bit words, four per key); return keys whose value is stored in it."""
    head, *entries = np.frombuffer(data[: len(data) // 8 * 8] or bytes(8), "<u2").reshape(-1, 4).tolist()
    return {key: value for key, place, _, value in entries[: head[3]] if place == 0 and key}


def _with_vertical_crs(chosen: CrsStatement, horizontal: CRS, other: CRS) -> CrsStatement:
    """Add the vertical CRS of the other record, if only that one states it."""
    vertical = vertical_of(other)
    if vertical is None or chosen.crs is None or chosen.crs.is_compound:
        return chosen
    note = f"only one of its two CRS records states a vertical CRS ({describe_crs(vertical)}); it is used"
    return replace(chosen, crs=with_vertical(horizontal, vertical), notes=(*chosen.notes, note))


def _with_height_unit(chosen: CrsStatement, other: CrsStatement) -> CrsStatement:
    """Add the unit of height of the other record, if only that one states it."""
    unit = _height_unit(other)
    if unit is None or _height_unit(chosen) is not None:
        return chosen
    note = f"only one of its two CRS records states a unit of height ({unit:g} m); it is used"
    return replace(chosen, metres_per_unit_z=unit, notes=(*chosen.notes, note))


def _height_unit(statement: CrsStatement) -> float | None:
    axes = statement.crs.axis_info if statement.crs is not None else []
    own = axes[2].unit_conversion_factor if len(axes) > 2 else None
    return statement.metres_per_unit_z or own


def _statement_from_keys(keys: dict[int, int], citation: str) -> CrsStatement | None:
    """Interpret GeoTIFF keys: EPSG codes and units; for a user-defined projection, units and a note."""
    if not keys:
        return None
    unit_code = keys.get(_LINEAR, 0)
    unit = linear_unit(unit_code)
    if unit is None and unit_code not in {0, _USER_DEFINED}:
        trouble = (
            f"its GeoTIFF keys name {unit_code} as the unit of easting and northing, which is not a unit of length"
        )
        return CrsStatement(trouble=trouble)
    vertical = _coded(keys, _VERTICAL)
    if vertical is not None and not vertical.is_vertical:
        vertical = None
    own = None if vertical is None else vertical.axis_info[0].unit_conversion_factor
    unit_z = linear_unit(keys.get(_VERTICAL_UNIT, 0)) or own
    if 0 < keys.get(_PROJECTED, 0) < _USER_DEFINED:
        return _projected(keys, unit, unit_z, vertical)
    if keys.get(_MODEL) in {2, 3}:
        return CrsStatement(_coded(keys, _GEODETIC) or crs_from_epsg(4326 if keys[_MODEL] == 2 else 4978))
    notes: tuple[str, ...] = ()
    if keys.get(_MODEL) == 1 or keys.get(_PROJECTED) == _USER_DEFINED:
        named = f" ('{citation}')" if citation else ""
        notes = (f"its GeoTIFF keys describe a CRS without a code{named}; pass `crs` to place it on Earth",)
    return CrsStatement(None, unit, unit_z, notes=notes)


def _projected(keys: dict[int, int], unit: float | None, unit_z: float | None, vertical: CRS | None) -> CrsStatement:
    code, crs = keys[_PROJECTED], _coded(keys, _PROJECTED)
    if crs is None:
        return CrsStatement(trouble=f"its GeoTIFF keys name EPSG:{code}, which PROJ does not know")
    own = crs.axis_info[0].unit_conversion_factor
    if unit is not None and crs.is_projected and abs(unit / own - 1) > _SAME_FOOT:
        trouble = f"its GeoTIFF keys name EPSG:{code}, whose unit is {own:g} m, and a unit of {unit:g} m"
        return CrsStatement(trouble=trouble)
    if vertical is not None and crs.is_projected:
        crs = with_vertical(crs, vertical)
    return CrsStatement(crs, metres_per_unit_z=unit_z)


def _coded(keys: dict[int, int], key: int) -> CRS | None:
    """Return the CRS of the EPSG code in a key; None if there is none that PROJ knows."""
    code = keys.get(key, 0)
    return crs_from_epsg(code) if 0 < code < _USER_DEFINED else None
