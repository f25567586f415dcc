"""Files that lie or are damaged, made from tiny valid surveys."""

from .cases import PLACES, hostile_files, odd_place
from .files import Case

__all__ = ["PLACES", "Case", "hostile_files", "odd_place"]
