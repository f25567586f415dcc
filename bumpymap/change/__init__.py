"""Changes between two surveys of a site: of the ground, and of the ride over it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
