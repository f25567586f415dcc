"""Readers of LiDAR scans of a moving robot, and of its poses."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
