"""Write the catalogue of what runs leave: a STAC item for each map, a STAC catalogue of many."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
