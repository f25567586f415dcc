"""Write what a route leaves: lines, tracks, profiles, pictures, rasters and contours of the reach."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
