"""Seeded ground of many kinds, as a surface, a heightmap or the points of a simulated survey."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
