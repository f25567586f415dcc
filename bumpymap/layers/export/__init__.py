"""Write a map for robots: occupancy grids and masks for Nav2, a grid_map message, a graph of ways, a mission plan."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
