"""The ride model: geometry rolls the vehicle over a patch, a calibration corrects what geometry leaves out."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
