"""Import pyarrow and pyogrio without pandas, which both import if it is installed."""

import sys
from importlib import import_module
from importlib.abc import MetaPathFinder
from typing import Any

__all__ = ["import_without_pandas"]


class _NoPandas(MetaPathFinder):
    """Import hook that hides pandas and geopandas, and leaves other modules to the next finders."""

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> None:
        """Raise ModuleNotFoundError for the two packages."""
        if fullname in {"pandas", "geopandas"}:
            raise ModuleNotFoundError(f"{fullname} is not imported here", name=fullname)


def import_without_pandas(*names: str) -> None:
    """Import modules while pandas is hidden; pyarrow, which looks for pandas once, does so now.

    No layer needs pandas, and importing it takes a third of a second. Afterwards pyogrio cannot make data frames in
    this process, so this is for the command line only, never for a process that runs a caller's code.

    Parameters
    ----------
    *names : str
        Dotted names of modules.
    """
    finder = _NoPandas()
    sys.meta_path.insert(0, finder)
    try:
        for name in names:
            import_module(name)
        import_module("pyarrow").array([0])  # pyarrow looks for pandas once, when it makes its first array
    finally:
        sys.meta_path.remove(finder)
