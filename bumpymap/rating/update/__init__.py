"""Move a calibration to measured drives: what they say, how sure it is, and the calibration that follows."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
