"""Machine code of compiled kernels, kept between runs and started without the compiler.

Importing numba and waking it up costs half a second of processor time, more than many a map. So a kernel module does
not import it. Its functions stay plain Python until an *entry* is called; the entry's machine code is read from a
cache and called through ctypes. Only where the cache has none does numba come in: the module is executed a second time
with its decorators switched to numba's, the entry is compiled, cut free of the interpreter and written to the cache.
That happens in processes beside the run, for all kernel modules at once: it takes less time, and the memory that a
compiler needs is not taken from the run.

What that asks of a kernel: arrays and numbers in, nothing out; no allocation, no exceptions, C-contiguous arrays, and
no calls but to kernels of the same module and to libm. An entry that breaks this rule still works, through numba.
"""

import ctypes
import gc
import importlib.util
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from bumpytiles._compiler import Code, compile_entry, link
from bumpytiles._kept import Store

__all__ = ["Entry", "compiled_twin", "entry", "inner", "keep", "order_free"]

_lock = threading.Lock()
_mode = threading.local()


def inner(function: Callable[..., Any]) -> Any:
    """Mark a part of kernels."""
    return function if _compiling() is None else _njit(function)


def order_free(function: Callable[..., Any]) -> Any:
    """Mark a part that takes minima and maxima of numbers without NaN: any order of them gives the same bits."""
    return function if _compiling() is None else _njit(function, fastmath={"nnan", "nsz"})


def entry(arguments: str) -> Callable[[Callable[..., Any]], Any]:
    """Mark a kernel that Python calls.

    Parameters
    ----------
    arguments : str
        Types, such as ``"f8 i8:1 f4:3"``: a NumPy type code each, with the number of dimensions where it is an array.
    """

    def mark(function: Callable[..., Any]) -> Any:
        return Entry(function, arguments) if _compiling() is None else _njit(function)

    return mark


@cache
def compiled_twin(module: str, *, callable_: bool = True) -> ModuleType:
    """Return a kernel module with every function compiled by numba when it is called: for tests, and to compile.

    Without ``callable_`` only compiled code can call them, and compiling takes four fifths of the time.
    """
    spec = importlib.util.find_spec(module)
    if spec is None or spec.loader is None:
        raise ModuleNotFoundError(f"there is no module {module}")
    twin = importlib.util.module_from_spec(spec)
    _mode.options = {} if callable_ else {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    try:
        spec.loader.exec_module(twin)
    finally:
        _mode.options = None
    return twin


def _compiling() -> dict[str, Any] | None:
    """Options to compile with while a twin is made; None elsewhere."""
    return getattr(_mode, "options", None)


class Entry:
    """A kernel that Python calls; found in the cache, or compiled, when it is called for the first time.

    Parameters
    ----------
    function : callable
        The plain function.
    arguments : str
        See ``entry``.
    """

    def __init__(self, function: Callable[..., Any], arguments: str) -> None:
        self.plain = function
        self._kinds = [
            (np.dtype(kind), int(dims or 0)) for kind, _, dims in (a.partition(":") for a in arguments.split())
        ]
        self._call: Callable[..., Any] | None = None
        self._lock = threading.Lock()
        _known.setdefault(function.__module__, []).append(self)

    def __call__(self, *arguments: Any) -> None:
        """Run the machine code; the interpreter's lock is free meanwhile."""
        if self._call is None:
            with self._lock:
                self._call = self._call or self._ready()
        self._call(*arguments)

    def _ready(self) -> Callable[..., Any]:
        module, name = self.plain.__module__, self.plain.__name__
        store = Store(self.plain)
        kept = store.load()
        if kept is None and store.can_keep:
            _children.compile(module)
            kept = store.load()
        if kept is None:
            kept = self.compile()
            if kept is None:
                return getattr(compiled_twin(module), name)  # type: ignore[no-any-return]
            store.save(kept)
        address = link(kept)
        raw = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p, *self._ctypes())(address)
        return lambda *arguments: self._run(raw, arguments)

    def compile(self) -> Code | None:
        """Compile; returns None where the entry breaks the rule for kernels."""
        with _lock:
            twin = compiled_twin(self.plain.__module__, callable_=False)
            return compile_entry(getattr(twin, self.plain.__name__), self._kinds)

    def _ctypes(self) -> list[Any]:
        """Types of the flattened arguments: an array is owner, parent, size, item size, data, shape, strides."""
        array = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_ssize_t, ctypes.c_ssize_t, ctypes.c_void_p]
        types: list[Any] = []
        for kind, dims in self._kinds:
            types += [*array, *[ctypes.c_ssize_t] * (2 * dims)] if dims else [np.ctypeslib.as_ctypes_type(kind)]
        return types

    def _run(self, raw: Callable[..., int], arguments: tuple[Any, ...]) -> None:
        if len(arguments) != len(self._kinds):
            raise TypeError(f"{self.plain.__name__} takes {len(self._kinds)} arguments, not {len(arguments)}")
        flat: list[Any] = []
        for number, (value, (kind, dims)) in enumerate(zip(arguments, self._kinds, strict=True)):
            if not dims:
                flat.append(kind.type(value).item())
                continue
            if value.dtype != kind or value.ndim != dims or not value.flags.c_contiguous:
                raise TypeError(
                    f"argument {number} of {self.plain.__name__} is {value.dtype} with {value.ndim} dimensions; "
                    f"it must be {kind} with {dims}, C-contiguous"
                )
            flat += [None, None, value.size, value.itemsize, value.ctypes.data, *value.shape, *value.strides]
        result, error = ctypes.c_void_p(), ctypes.c_void_p()
        if raw(ctypes.addressof(result), ctypes.addressof(error), *flat) not in (0, -2):
            raise RuntimeError(f"the kernel {self.plain.__name__} failed")


def keep(*modules: str) -> None:
    """Compile what the cache has not of some kernel modules, and keep it: the work of a child."""
    gc.disable()  # a compiler makes millions of objects and few cycles: 7 % of the time
    for module in modules:
        import_module(module)
        for one in _known.get(module, []):
            store = Store(one.plain)
            if store.load() is None:
                code = one.compile()
                if code is not None:
                    store.save(code)


_known: dict[str, list[Entry]] = {}
"""Entries by kernel module."""


class _Children:
    """Processes that compile all kernel modules at once, started when one of them is needed."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._at_work: dict[str, subprocess.Popen[bytes] | None] = {}

    def compile(self, module: str) -> None:
        """Return when a kernel module has been compiled, or cannot be compiled in this way."""
        with self._lock:
            new = [name for name in _known if name not in self._at_work]
            stale = [name for name in new if any(Store(one.plain).load() is None for one in _known[name])]
            for share in _deal(stale, os.cpu_count() or 1):
                self._at_work |= dict.fromkeys(share, _start(share))
            child = self._at_work.get(module)
        if child is not None:
            child.wait()


_children = _Children()


def _deal(modules: list[str], hands: int) -> list[list[str]]:
    """Share modules out so that the longest source that one hand gets is short."""
    shares: list[list[str]] = [[] for _ in range(min(hands, len(modules)))]
    length = {name: Path(_known[name][0].plain.__code__.co_filename).stat().st_size for name in modules}
    for name in sorted(modules, key=lambda name: -length[name]):
        min(shares, key=lambda share: sum(length[held] for held in share)).append(name)
    return shares


def _start(modules: list[str]) -> subprocess.Popen[bytes] | None:
    """Start a child; None where that cannot be done."""
    if not sys.executable or getattr(sys, "frozen", False):
        return None
    code = f"import sys; from {__name__} import keep; keep(*sys.argv[1:])"
    env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    nothing = subprocess.DEVNULL
    with suppress(OSError):
        command = [sys.executable, "-P", "-c", code, *modules]
        return subprocess.Popen(command, env=env, stdin=nothing, stdout=nothing, stderr=nothing)  # noqa: S603 (ours)
    return None


def _njit(function: Callable[..., Any], **options: Any) -> Any:
    from numba import njit

    return njit(nogil=True, error_model="numpy", **options, **(_compiling() or {}))(function)
