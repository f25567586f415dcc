"""Machine code of compiled kernels, kept between runs and started without the compiler.

Importing numba and waking it up costs half a second of processor time, more than many a map. So a kernel module does
not import it. Its functions stay plain Python until an *entry* is called; the entry's machine code is read from a
cache and called through ctypes. Only where the cache has none does numba come in: the module is executed a second time
with its decorators switched to numba's, the entry is compiled, cut free of the interpreter and written to the cache.

What that asks of a kernel: arrays and numbers in, nothing out; no allocation, no exceptions, C-contiguous arrays, and
no calls but to kernels of the same module and to libm. An entry that breaks this rule still works, through numba.
"""

import ctypes
import gc
import hashlib
import importlib.util
import json
import logging
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

__all__ = ["Entry", "compiled_twin", "entry", "inner", "order_free"]

_log = logging.getLogger(__name__)
_lock = threading.RLock()
_mode = threading.local()
_FORMAT = 1
_LIBM = frozenset({"acos", "erfc", "exp", "fmax", "fmin", "log", "memcpy", "memmove", "memset", "pow"})
"""What machine code may call outside itself."""


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

    def __call__(self, *arguments: Any) -> None:
        """Run the machine code; the interpreter's lock is free meanwhile."""
        if self._call is None:
            with _lock:
                self._call = self._call or self._ready()
        self._call(*arguments)

    def _ready(self) -> Callable[..., Any]:
        store = _Store(self.plain)
        kept = store.load()
        if kept is None:
            module, name = self.plain.__module__, self.plain.__name__
            with _without_collector():
                kept = _compile(getattr(compiled_twin(module, callable_=False), name), self._kinds)
            if kept is None:
                return getattr(compiled_twin(module), name)  # type: ignore[no-any-return]
            store.save(kept)
        address = _link(kept)
        raw = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p, *self._ctypes())(address)
        return lambda *arguments: self._run(raw, arguments)

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


class _Code(NamedTuple):
    """Machine code of one entry."""

    symbol: str
    outside: list[str]
    """What it calls outside itself."""
    code: bytes
    """An object file."""


class _Store:
    """Where the machine code of one entry is kept: one file for each kind of processor, replaced when it is stale."""

    def __init__(self, function: Callable[..., Any]) -> None:
        source = Path(function.__code__.co_filename)
        machine = _machine()
        parts = [source.read_bytes(), Path(__file__).read_bytes(), _versions(), machine, function.__name__.encode()]
        self._key = hashlib.sha256(b"\0".join(parts)).hexdigest()
        name = f"{source.stem}.{function.__name__}.{hashlib.sha256(machine).hexdigest()[:8]}.native"
        own = os.environ.get("NUMBA_CACHE_DIR")
        user = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "bumpytiles"
        self._files = [folder / name for folder in ([Path(own)] if own else [source.parent / "__pycache__", user])]

    def load(self) -> "_Code | None":
        """Return the machine code, None where there is none for this source, compiler and processor."""
        for file in self._files:
            with suppress(OSError, ValueError, KeyError):
                head, _, code = file.read_bytes().partition(b"\n")
                record = json.loads(head)
                whole = record["digest"] == hashlib.sha256(code).hexdigest()
                if whole and record["key"] == self._key and _found(record["outside"]):
                    return _Code(record["symbol"], record["outside"], code)
        return None

    def save(self, code: "_Code") -> None:
        """Keep machine code in the first folder that can be written; a file appears whole or not at all."""
        digest = hashlib.sha256(code.code).hexdigest()
        record = {"key": self._key, "digest": digest, "symbol": code.symbol, "outside": code.outside}
        for file in self._files:
            try:
                file.parent.mkdir(parents=True, exist_ok=True)
                part = file.with_name(f".{file.name}.{os.getpid()}")
                part.write_bytes(json.dumps(record).encode() + b"\n" + code.code)
                part.replace(file)
            except OSError as error:
                _log.debug("cannot keep compiled kernels in %s: %s", file.parent, error)
            else:
                return


@contextmanager
def _without_collector() -> Iterator[None]:
    """Keep the garbage collector away: a compiler makes millions of objects and few cycles (7 % of the time)."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _njit(function: Callable[..., Any], **options: Any) -> Any:
    from numba import njit

    return njit(nogil=True, error_model="numpy", **options, **(_compiling() or {}))(function)


@cache
def _llvm() -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm


def _machine() -> bytes:
    llvm = _llvm()
    return f"{llvm.get_process_triple()} {llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}".encode()


def _versions() -> bytes:
    """Say which compiler would be at work, without importing it."""
    import llvmlite

    spec = importlib.util.find_spec("numba")
    numba = Path(spec.origin).with_name("_version.py") if spec is not None and spec.origin else None
    stated = numba.read_bytes() if numba is not None and numba.is_file() else b""
    return f"{_FORMAT} {llvmlite.__version__} ".encode() + stated


@cache
def _target() -> Any:
    llvm = _llvm()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        codemodel="jitdefault",
        jit=True,
    )


def _compile(dispatcher: Any, kinds: list[tuple[np.dtype[Any], int]]) -> _Code | None:
    """Compile an entry; returns its machine code, None where that needs more than itself and libm."""
    from numba import from_dtype, types

    plain = [from_dtype(kind) for kind, _ in kinds]
    signature = types.void(
        *(types.Array(kind, dims, "C") if dims else kind for kind, (_, dims) in zip(plain, kinds, strict=True))
    )
    dispatcher.compile(signature)
    compiled = dispatcher.overloads[signature.args]
    symbol = compiled.fndesc.llvm_func_name
    llvm = _llvm()
    module = llvm.parse_assembly(compiled.library.get_llvm_str())
    # Reference counts of arrays that Python owns stay untouched; the call behind them is never reached.
    module.link_in(llvm.parse_assembly("define void @NRT_MemInfo_call_dtor(ptr %info) { ret void }"))
    for function in module.functions:
        if not function.is_declaration and function.name != symbol:
            function.linkage = "internal"
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.add_strip_dead_prototype_pass()
    passes.run(module, llvm.create_pass_builder(_target(), llvm.create_pipeline_tuning_options()))
    outside = {f.name for f in module.functions if f.is_declaration and not f.name.startswith("llvm.")}
    outside |= {g.name for g in module.global_variables if g.is_declaration}
    if not _found(outside):
        _log.debug("%s is compiled in every run: it calls %s", symbol, ", ".join(sorted(outside)))
        return None
    return _Code(symbol, sorted(outside), _target().emit_object(module))


def _found(outside: Iterable[str]) -> bool:
    """Tell the linker where libm is; False where something else is wanted (the linker would end the process)."""
    process = ctypes.CDLL("ucrtbase" if os.name == "nt" else None)
    for name in outside:
        if name not in _LIBM or not hasattr(process, name):
            return False
        _llvm().add_symbol(name, ctypes.cast(getattr(process, name), ctypes.c_void_p).value)
    return True


_engines: list[Any] = []
"""Hold the machine code in memory for as long as the process lives."""


def _link(code: _Code) -> int:
    """Load machine code; returns the address of its entry."""
    llvm = _llvm()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code.code))
    engine.finalize_object()
    _engines.append(engine)
    return int(engine.get_function_address(code.symbol))
