"""Files that lie or are damaged, made from tiny valid surveys."""

from .files import Case
from .hostile_cases import PLACES, hostile_files, odd_place

__all__ = ["PLACES", "Case", "hostile_files", "odd_place"]
