"""Job 2, scan: frames of a moving robot in, classed sectors and their layers out."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
