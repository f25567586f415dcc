"""Import pyarrow and pyogrio without pandas, which both load wherever it is installed."""

import sys
from importlib import import_module
from importlib.abc import MetaPathFinder
from typing import Any

__all__ = ["import_without_pandas"]


class _NoPandas(MetaPathFinder):
    """Finds no pandas and no geopandas, and leaves every other module to the finders after it."""

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> None:
        """Refuse the two modules."""
        if fullname in {"pandas", "geopandas"}:
            raise ModuleNotFoundError(f"{fullname} is not imported here", name=fullname)


def import_without_pandas(*names: str) -> None:
    """Import modules, and let pyarrow look for pandas, while pandas cannot be found.

    No layer needs pandas, and it takes a third of a second. pyogrio, imported so, makes no data frames in this process:
    for a process of the command line, which runs no code of others, and not for callers of the library.

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
        import_module("pyarrow").array([0])  # pyarrow looks for pandas once, with the first array that it makes
    finally:
        sys.meta_path.remove(finder)
