"""The tiling engine: points in, tiles out. It is independent of roughness."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
