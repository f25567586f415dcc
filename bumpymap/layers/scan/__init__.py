"""Write the files of a scan run: polygons, clouds, pictures, a table of sectors, an accumulated survey."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
