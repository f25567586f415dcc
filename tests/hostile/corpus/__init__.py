"""Files that lie or are damaged, made from tiny valid surveys."""

from .files import PLACES, Case, hostile_files, odd_place

__all__ = ["PLACES", "Case", "hostile_files", "odd_place"]
