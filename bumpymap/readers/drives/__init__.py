"""Readers of recorded drives: what inertial sensors, receivers and wheels of a vehicle recorded."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
