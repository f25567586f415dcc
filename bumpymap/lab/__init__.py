"""Development tools that no job imports: simulation, synthetic ground, training, evaluation."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
