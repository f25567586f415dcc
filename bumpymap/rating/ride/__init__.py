"""The ride model: roll the vehicle's geometry over a patch, then correct the result with a calibration."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
