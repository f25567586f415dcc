"""Write what people and robots look at: pages, GIS styles, pictures, maps and missions for robots."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
