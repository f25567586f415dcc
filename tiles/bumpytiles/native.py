"""Compiled kernels that start without their compiler.

numba is the compiler, and importing it and its cache takes longer than many a map. So no kernel module imports it:

- `helper` and `kernel` leave a function plain Python. A kernel compiles when it is called for the first time, or finds
  its machine code in a cache.
- To compile, numba is told of all helpers (``register_jitable``), so that kernels call helpers of any module, and makes
  the kernel a C function (``cfunc``), its documented door for callers that are not numba.
- LLVM alone optimises that function, writes it to the cache, and loads it in later runs; ctypes calls it.

Compiling happens in processes beside the run, for all kernel modules at once: it takes less time, and the memory that
a compiler needs is not taken from the run. It takes many seconds, so it is told how far it is (`compiling_reports`).

What that asks of a kernel: annotated parameters and no result. A parameter is a number, an array
(``Annotated[NDArray[np.float64], 2]``: two dimensions, C-contiguous) or a NamedTuple of these. No allocation, no
exceptions, no calls but to helpers and to libm.
"""

import ctypes
import gc
import logging
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

from bumpytiles._compiler import Code, KernelSource, Options, compile_source, jit, link
from bumpytiles._kept import Store
from bumpytiles.processes import start_python

__all__ = ["Kernel", "compile_packages", "compiling_reports", "helper", "jitted", "kernel", "order_free"]

_log = logging.getLogger(__name__)

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
    """Compile what the cache has not of some kernel modules, and keep it: the work of a child, a byte a kernel."""
    gc.disable()  # a compiler makes millions of objects and few cycles: 7 % of the time
    for module in modules:
        import_module(module)
        for each in _kernels.get(module, []):
            store = Store(each.source)
            if store.load() is None:
                store.save(each.compile())
                with suppress(OSError):  # the parent has ended
                    os.write(1, b".")


def compile_packages(*packages: str, at_once: bool = True) -> bool:
    """Compile what the cache has not of all kernels in some packages; False where nothing can be kept.

    Parameters
    ----------
    *packages : str
    at_once : bool
        False: only if one of the kernels that are loaded already is not in the cache.
    """
    stores = [Store(each.source) for kernels in _kernels.values() for each in kernels]
    if not at_once and all(store.load() is not None or not store.can_keep for store in stores):
        return True
    names = [
        ".".join((package, *file.relative_to(folder).with_suffix("").parts))
        for package in packages
        for folder in map(Path, import_module(package).__path__)
        for file in sorted(folder.rglob("*.py"))
        if "\n@kernel\n" in file.read_text(encoding="utf-8")
    ]
    for name in names:
        import_module(name)
    if not all(Store(each.source).can_keep for name in names for each in _kernels[name]):
        return False
    _children.compile(*names)
    return all(Store(each.source).load() is not None for name in names for each in _kernels[name])


_reports: list[Callable[[int, int], None]] = []


@contextmanager
def compiling_reports(report: Callable[[int, int], None]) -> Iterator[None]:
    """Call ``report`` with the number of kernels compiled and to compile, from any thread, during the body."""
    _reports.append(report)
    try:
        yield
    finally:
        _reports.remove(report)


class _Children:
    """Processes that compile all kernel modules at once, started when one of them is needed."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._by_module: dict[str, subprocess.Popen[bytes] | None] = {}
        self._done = self._total = 0

    def compile(self, *modules: str) -> None:
        """Return when kernel modules have been compiled, or cannot be compiled in this way."""
        with self._lock:
            new = [name for name in _kernels if name not in self._by_module]
            missing = {name: [each for each in _kernels[name] if Store(each.source).load() is None] for name in new}
            size = {name: sum(each.source.size for each in kernels) for name, kernels in missing.items() if kernels}
            shares: list[list[str]] = [[] for _ in range(min(os.cpu_count() or 1, len(size)))]
            for name in sorted(size, key=lambda name: -size[name]):
                min(shares, key=lambda share: sum(size[held] for held in share)).append(name)
            started = [(child, share) for share in shares if (child := _start(share)) is not None]
            self._by_module |= dict.fromkeys(new) | {name: child for child, share in started for name in share}
            counts = [(child, sum(len(missing[name]) for name in share)) for child, share in started]
            if counts:
                self._count(sum(kernels for _, kernels in counts), 0)
            for child, kernels in counts:
                self._follow(child, kernels)
            children = {child for child in map(self._by_module.get, modules) if child is not None}
        for child in children:
            child.wait()

    def _follow(self, child: "subprocess.Popen[bytes]", kernels: int) -> None:
        """Count a child's kernels as it compiles them."""

        def read() -> None:
            for _ in range(kernels):
                if child.stdout is not None:
                    child.stdout.read(1)  # returns at once when the child has ended
                self._count(0, 1)

        with suppress(RuntimeError):  # no thread can be started: it is not told how far it is
            threading.Thread(target=read, daemon=True, name="compiling").start()

    def _count(self, kernels: int, done: int) -> None:
        with self._lock:
            self._total += kernels
            self._done += done
            for report in _reports:
                report(self._done, self._total)
        if kernels > 0 and not _reports:
            _log.info("compiling %d numerical kernels, once; this takes many seconds", kernels)


_children = _Children()


def _start(modules: list[str]) -> subprocess.Popen[bytes] | None:
    """Start a child, which writes a byte for each kernel; None where that cannot be done."""
    if not sys.executable or getattr(sys, "frozen", False):
        return None
    code = f"import sys; from {__name__} import compile_modules; compile_modules(*sys.argv[1:])"
    # Helpers are optimised once, as parts of a kernel, not by numba before that.
    env = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "NUMBA_OPT": "0"}
    with suppress(OSError):
        return start_python(["-c", code, *modules], environment=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    return None
