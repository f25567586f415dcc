"""bumpymap: roughness layers and ride-cost maps from point clouds."""

from importlib.metadata import version

__all__ = ["__version__"]

__version__ = version("bumpymap")
