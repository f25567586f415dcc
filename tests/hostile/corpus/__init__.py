"""Files that lie or are damaged, made from tiny valid surveys."""

from .files import Case
from .las_cases import copc_cases, las_cases, laz_cases
from .other_cases import PLACES, foreign_cases, odd_place, pcd_cases, ply_cases

__all__ = ["PLACES", "Case", "hostile_files", "odd_place"]


def hostile_files():
    """Every hostile file, the same bytes every time."""
    return [*las_cases(), *laz_cases(), *copc_cases(), *ply_cases(), *pcd_cases(), *foreign_cases()]
