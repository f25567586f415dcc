"""pyogrio, imported without pandas and geopandas, which it loads wherever they are installed.

It only asks for their versions then, and nothing here needs more. They take a fifth of a second of processor time.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from types import ModuleType
from typing import Any

__all__ = ["announced"]


class _Announced(ModuleType):
    """A package that tells its version, and is imported when anything else of it is asked for."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.__version__ = version(name)

    def __getattr__(self, name: str) -> Any:
        _withdraw(self)
        return getattr(import_module(self.__name__), name)


@contextmanager
def announced(*names: str) -> Iterator[None]:
    """Let packages that are installed, but not imported yet, only be announced while the body imports others."""
    stands_in: list[_Announced] = []
    try:
        for name in names:
            if name not in sys.modules:
                try:
                    stands_in.append(_Announced(name))
                except PackageNotFoundError:
                    continue
                sys.modules.setdefault(name, stands_in[-1])
        yield
    finally:
        for module in stands_in:
            _withdraw(module)


def _withdraw(module: _Announced) -> None:
    if sys.modules.get(module.__name__) is module:
        del sys.modules[module.__name__]
