"""Coordinate reference systems and units: what a file and its user say, made into one ``Georeference``."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
