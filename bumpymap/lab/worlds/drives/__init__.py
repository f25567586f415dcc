"""Simulated drive logs: the true motion of a vehicle, the faults of its sensors, the files of its logger."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
