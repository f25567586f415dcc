"""Compiled kernels that start without their compiler.

numba is the compiler, and importing it and its cache takes longer than many a map. So no kernel module imports it:

- `helper` and `kernel` leave a function plain Python. A kernel compiles when it is called for the first time, or finds
  its machine code in a cache.
- To compile, numba is told of all helpers (``register_jitable``), so that kernels call helpers of any module, and makes
  the kernel a C function (``cfunc``), its documented door for callers that are not numba.
- LLVM alone optimises that function, writes it to the cache, and loads it in later runs; ctypes calls it.

Compiling happens in processes beside the run, for all kernel modules at once: it takes less time, and the memory that
a compiler needs is not taken from the run.

What that asks of a kernel: annotated parameters and no result. A parameter is a number, an array
(``Annotated[NDArray[np.float64], 2]``: two dimensions, C-contiguous) or a NamedTuple of these. No allocation, no
exceptions, no calls but to helpers and to libm.
"""

import ctypes
import gc
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from importlib import import_module
from typing import Any, Generic, ParamSpec, TypeVar

from bumpytiles._compiler import Code, KernelSource, Options, compile_source, jit, link
from bumpytiles._kept import Store
from bumpytiles.processes import start_python

__all__ = ["Kernel", "compile_modules", "helper", "jitted", "kernel", "order_free"]

P = ParamSpec("P")
F = TypeVar("F", bound=Callable[..., Any])

_helpers: dict[Callable[..., Any], Options] = {}
"""Functions that kernels may call, and how each is compiled."""
_kernels: dict[str, list["Kernel[Any]"]] = {}
"""Kernels by module."""
_compiling = threading.Lock()


def helper(function: F) -> F:
    """Mark a function that kernels and other helpers call."""
    _helpers[function] = {}
    return function


def order_free(function: F) -> F:
    """Mark a helper that takes minima and maxima of numbers without NaN: any order of them gives the same bits."""
    _helpers[function] = {"fastmath": {"nnan", "nsz"}}
    return function


def jitted(function: Callable[..., Any]) -> Any:
    """Return a helper compiled by numba in this process, to be called from Python."""
    with _compiling:
        return jit(function, _helpers)


def kernel(function: Callable[P, None]) -> "Kernel[P]":
    """Mark a function that Python calls as compiled code; see the module for what it may do."""
    return Kernel(function)


class Kernel(Generic[P]):
    """A compiled function that Python calls.

    Parameters
    ----------
    function : callable
        The plain function.
    """

    def __init__(self, function: Callable[P, None]) -> None:
        self.plain = function
        self._call: Callable[..., None] | None = None
        self._lock = threading.Lock()
        _kernels.setdefault(function.__module__, []).append(self)

    @cached_property
    def source(self) -> KernelSource:
        """What is compiled."""
        return KernelSource.of(self.plain, _helpers)

    def __call__(self, *arguments: P.args, **named: P.kwargs) -> None:
        """Run the machine code; the interpreter's lock is free meanwhile."""
        if named:
            raise TypeError(f"{self.source.name} takes its arguments by position")
        if self._call is None:
            with self._lock:
                self._call = self._call or self._ready()
        self._call(*self.source.c_arguments(arguments))

    def _ready(self) -> Callable[..., None]:
        store = Store(self.source)
        code = store.load()
        if code is None and store.can_keep:
            _children.compile(self.plain.__module__)
            code = store.load()
        if code is None:
            code = self.compile()
            store.save(code)
        return ctypes.CFUNCTYPE(None, *self.source.c_types)(link(code))

    def compile(self) -> Code:
        """Compile in this process."""
        with _compiling:
            return compile_source(self.source, _helpers)


def compile_modules(*modules: str) -> None:
    """Compile what the cache has not of some kernel modules, and keep it: the work of a child."""
    gc.disable()  # a compiler makes millions of objects and few cycles: 7 % of the time
    for module in modules:
        import_module(module)
        for each in _kernels.get(module, []):
            store = Store(each.source)
            if store.load() is None:
                store.save(each.compile())


class _Children:
    """Processes that compile all kernel modules at once, started when one of them is needed."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._by_module: dict[str, subprocess.Popen[bytes] | None] = {}

    def compile(self, module: str) -> None:
        """Return when a kernel module has been compiled, or cannot be compiled in this way."""
        with self._lock:
            new = [name for name in _kernels if name not in self._by_module]
            stale = [name for name in new if any(Store(each.source).load() is None for each in _kernels[name])]
            size = {name: sum(each.source.size for each in _kernels[name]) for name in stale}
            shares: list[list[str]] = [[] for _ in range(min(os.cpu_count() or 1, len(stale)))]
            for name in sorted(stale, key=lambda name: -size[name]):
                min(shares, key=lambda share: sum(size[held] for held in share)).append(name)
            for share in shares:
                self._by_module |= dict.fromkeys(share, _start(share))
            child = self._by_module.get(module)
        if child is not None:
            child.wait()


_children = _Children()


def _start(modules: list[str]) -> subprocess.Popen[bytes] | None:
    """Start a child; None where that cannot be done."""
    if not sys.executable or getattr(sys, "frozen", False):
        return None
    code = f"import sys; from {__name__} import compile_modules; compile_modules(*sys.argv[1:])"
    # Helpers are optimised once, as parts of a kernel, not by numba before that.
    env = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "NUMBA_OPT": "0"}
    with suppress(OSError):
        return start_python(["-c", code, *modules], environment=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    return None
