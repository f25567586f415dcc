"""The vertical part of a CRS: from which zero heights count.

Heights are metres everywhere in bumpymap, whatever the unit of a vertical CRS is. So the layers carry one that is in
metres and leave out any other; of files, the zero alone must agree.
"""

from pyproj import CRS
from pyproj.crs import CompoundCRS

__all__ = ["in_metres", "same_zero", "vertical_of", "with_vertical"]


def vertical_of(crs: CRS) -> CRS | None:
    """Vertical part of a compound CRS; None where there is none, or one of depths."""
    if not crs.is_compound:
        return None
    vertical = crs.sub_crs_list[-1]
    if vertical.is_bound and vertical.source_crs is not None:
        vertical = vertical.source_crs  # a grid that leads to the ellipsoid does not change the zero
    axes = vertical.axis_info
    return vertical if vertical.is_vertical and len(axes) == 1 and axes[0].direction == "up" else None


def in_metres(vertical: CRS) -> bool:
    """Whether heights of a vertical CRS are in metres."""
    return bool(vertical.axis_info[0].unit_conversion_factor == 1.0)


def same_zero(first: CRS, second: CRS) -> bool:
    """Whether heights of two vertical CRS count from one zero, in whatever units."""
    if first == second:
        return True
    one, other = first.datum, second.datum
    return one is not None and other is not None and (one == other or _plain(one.name) == _plain(other.name))


def with_vertical(horizontal: CRS, vertical: CRS, stated: CRS | None = None) -> CRS:
    """Join two CRS; ``stated`` itself where it is the two of them, so that its own name and code stay."""
    if stated is not None and stated.is_compound and stated.sub_crs_list == [horizontal, vertical]:
        return stated
    joined = CompoundCRS(f"{horizontal.name} + {vertical.name}", [horizontal, vertical])
    return CRS.from_json_dict(joined.to_json_dict())  # a CompoundCRS has no to_2d


def _plain(name: str) -> str:
    """Name of a datum without what writers spell in several ways."""
    return "".join(letter for letter in name.casefold() if letter.isalnum())
