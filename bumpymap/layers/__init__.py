"""Write the files of a run (rasters, vectors, tables, manifest) and read them back."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
