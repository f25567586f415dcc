"""Files that lie or are damaged, made from tiny valid surveys."""

from .case import EITHER, MAPPED, REFUSED, Case
from .copc_cases import copc_cases
from .foreign_cases import PLACES, foreign_cases
from .las_cases import las_cases
from .laz_cases import laz_cases
from .pcd_cases import pcd_cases
from .ply_cases import ply_cases

__all__ = ["EITHER", "MAPPED", "PLACES", "REFUSED", "Case", "hostile_files"]


def hostile_files():
    """Every hostile file, the same bytes every time."""
    return [*las_cases(), *laz_cases(), *copc_cases(), *ply_cases(), *pcd_cases(), *foreign_cases()]
