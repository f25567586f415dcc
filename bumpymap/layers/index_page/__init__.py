"""index.html of a batch: one page with all its surveys, to open from the disk or a server, without a network."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
