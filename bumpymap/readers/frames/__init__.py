"""Scans of a moving robot's LiDAR and its poses: files in, frames out."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
