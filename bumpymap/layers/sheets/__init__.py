"""Write a large map in sheets: folders of layers on the shared grid, and virtual rasters over all of them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
