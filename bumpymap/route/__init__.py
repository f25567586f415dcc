"""Find ways over a map of costs: the cheapest way between two points, and what a line feels."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
