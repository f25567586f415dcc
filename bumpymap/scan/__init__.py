"""Dynamic scenes: one scan of a moving robot in, classed sectors out."""

from bumpymap.scan.paper import classify_paper, paper_settings
from bumpymap.scan.points import point_classes
from bumpymap.scan.polar import polar_sectors
from bumpymap.scan.stripes import StripeFilter, StripeModel, classify_filter, fit_stripes, load_stripes, save_stripes
from bumpymap.scan.types import (
    CLASSES,
    NOT_TRAVERSABLE,
    ClassedSectors,
    Dropped,
    PolarSettings,
    Scan,
    ScanMethod,
    SectorStack,
)

__all__ = [
    "CLASSES",
    "NOT_TRAVERSABLE",
    "ClassedSectors",
    "Dropped",
    "PolarSettings",
    "Scan",
    "ScanMethod",
    "SectorStack",
    "StripeFilter",
    "StripeModel",
    "classify_filter",
    "classify_paper",
    "fit_stripes",
    "load_stripes",
    "paper_settings",
    "point_classes",
    "polar_sectors",
    "save_stripes",
]
