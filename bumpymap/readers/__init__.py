"""Readers of all point cloud formats: files in, chunks of points in metres out."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
