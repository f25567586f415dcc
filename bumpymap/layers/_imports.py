"""Imports that wait or leave something out: pyarrow and pyogrio without pandas, packages of the extra ``notebook``."""

import sys
from importlib import import_module
from importlib.abc import MetaPathFinder
from typing import Any

from bumpymap.core import UsageError, install_command

_HIDDEN = frozenset(
    {
        *("pandas", "geopandas", "cloudpickle"),
        # pyarrow's readers of object stores: libraries of 10 ms
        *("pyarrow._azurefs", "pyarrow._gcsfs", "pyarrow._hdfs", "pyarrow._s3fs"),
    }
)


class _Hidden(MetaPathFinder):
    """Import hook that hides modules, and leaves all others to the next finders."""

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> None:
        """Raise ModuleNotFoundError for what is hidden."""
        if fullname in _HIDDEN:
            raise ModuleNotFoundError(f"{fullname} is not imported here", name=fullname)


def import_without_pandas(*names: str) -> None:
    """Import modules while pandas is hidden, from all threads; pyarrow, which looks for pandas once, does so now.

    No layer needs pandas, and importing it takes a third of a second. Nor do layers need pyarrow's readers of object
    stores, or cloudpickle. Afterwards pyogrio cannot make data frames in this process, so this is for the command line
    only, never for a process that runs a caller's code. ``*names``: dotted names of modules.
    """
    finder = _Hidden()
    sys.meta_path.insert(0, finder)
    try:
        for name in names:
            import_module(name)
        import_module("pyarrow").array([0])  # pyarrow looks for pandas once, when it makes its first array
    finally:
        sys.meta_path.remove(finder)


def import_notebook(package: str) -> Any:
    """Import a package of the extra ``notebook``."""
    try:
        return import_module(package)
    except ImportError as error:
        raise UsageError(
            f"this needs {package}, which cannot be imported ({error}): {install_command('notebook')}"
        ) from error
