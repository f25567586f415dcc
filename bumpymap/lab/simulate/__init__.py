"""Drive a vehicle over synthetic terrain and make a calibration. Driving needs the extra ``sim``."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
