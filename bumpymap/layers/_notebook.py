"""Packages of the extra ``notebook``, imported where they are used."""

from importlib import import_module
from typing import Any

from bumpymap.core import UsageError

__all__ = ["import_notebook"]


def import_notebook(package: str) -> Any:
    """Import a package of the extra ``notebook``."""
    try:
        return import_module(package)
    except ImportError as error:
        raise UsageError(
            f"this needs {package}, which cannot be imported ({error}): pip install 'bumpymap[notebook]'"
        ) from error
