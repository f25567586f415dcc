"""Train the texture network and the scan network and write them as ONNX files. Needs the extra ``learn``."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
