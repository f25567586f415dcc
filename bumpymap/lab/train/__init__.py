"""Trains the texture network and writes it as an ONNX file. Needs the extra ``learn``."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
