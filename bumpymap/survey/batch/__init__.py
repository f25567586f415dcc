"""A batch: many surveys, each mapped to a folder of its own, with one summary."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
