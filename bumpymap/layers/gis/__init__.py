"""Write styles and a project with which QGIS shows the layers of a map as they are meant."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
