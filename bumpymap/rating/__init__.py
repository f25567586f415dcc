"""Heightmaps in; class, ride cost with its interval, probability of failure and cost out."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
