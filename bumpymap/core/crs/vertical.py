"""The vertical part of a CRS.

bumpymap converts all heights to metres. The layers therefore carry a vertical CRS only if its unit is the metre, and
the files of a run need to agree in the vertical datum only.
"""

from pyproj import CRS
from pyproj.crs import CompoundCRS

__all__ = ["in_metres", "same_datum", "vertical_of", "with_vertical"]


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
    return one is not None and other is not None and (one == other or _plain(one.name) == _plain(other.name))


def with_vertical(horizontal: CRS, vertical: CRS, stated: CRS | None = None) -> CRS:
    """Join two CRS; return ``stated`` if it is made of these two, to keep its name and code."""
    if stated is not None and stated.is_compound and stated.sub_crs_list == [horizontal, vertical]:
        return stated
    joined = CompoundCRS(f"{horizontal.name} + {vertical.name}", [horizontal, vertical])
    return CRS.from_json_dict(joined.to_json_dict())  # a CompoundCRS has no to_2d


def _plain(name: str) -> str:
    """Return the name of a datum in lower case, letters and digits only, since spellings vary."""
    return "".join(letter for letter in name.casefold() if letter.isalnum())
