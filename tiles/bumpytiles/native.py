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

*Files of machine code.* Whoever can change a file of machine code decides what its reader runs. So a file counts only
where nobody but the user or root can have written it: both own it and its folder, nobody else may write to either, and
neither is a link. All else is as if it were not there, and nothing is kept where it would not count.

*Processes.* Python puts the current folder, where strangers' files may lie, on the path of ``python -c`` and so of what
`multiprocessing` starts. No process that is started here has it there, nor has any that those start.
"""

import ctypes
import gc
import hashlib
import json
import logging
import os
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar
from uuid import uuid4

from bumpytiles._compiler import Code, KernelSource, Options, compile_source, jit, link, linkable, machine, versions

__all__ = [
    "Kernel",
    "Store",
    "blocked_signals",
    "compile_packages",
    "compiling_reports",
    "helper",
    "jitted",
    "kernel",
    "order_free",
    "start_python",
]

_log = logging.getLogger(__name__)


class Store:
    """Where the machine code of one kernel is kept: one file for each kind of processor, replaced when it is stale."""

    def __init__(self, source: KernelSource) -> None:
        processor = machine()
        parts = [*source.parts(), *_own_source(), versions(), processor, source.name.encode()]
        self._key = hashlib.sha256(b"\0".join(parts)).hexdigest()
        name = f"{source.file.stem}.{source.name}.{hashlib.sha256(processor).hexdigest()[:8]}.native"
        self._files = [folder / name for folder in _folders(source.file)]

    @property
    def can_keep(self) -> bool:
        """Whether there is a folder for it; where there is none, it is said once why."""
        faults = {str(file.parent): _fault(file.parent) for file in self._files}
        if None in faults.values():
            return True
        _say_once(", ".join(f"{folder} ({fault})" for folder, fault in faults.items()))
        return False

    def load(self) -> Code | None:
        """Return the machine code, None where there is none for this source, compiler and processor."""
        for file in self._files:
            with suppress(OSError, ValueError, KeyError):
                head, _, code = _read(file).partition(b"\n")
                record = json.loads(head)
                whole = record["digest"] == hashlib.sha256(code).hexdigest()
                if whole and record["key"] == self._key and linkable(record["outside"]):
                    return Code(record["symbol"], record["outside"], code)
        return None

    def save(self, code: Code) -> None:
        """Keep machine code in the first folder that will do; a file appears whole or not at all."""
        digest = hashlib.sha256(code.code).hexdigest()
        record = {"key": self._key, "digest": digest, "symbol": code.symbol, "outside": code.outside}
        for file in self._files:
            try:
                file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                _write(file, json.dumps(record).encode() + b"\n" + code.code)
            except OSError as error:
                _log.debug("cannot keep compiled kernels in %s: %s", file.parent, error)
            else:
                return


def _folders(source: Path) -> list[Path]:
    """Where to look, in this order: a container's user may have no home. Only on POSIX do files have owners."""
    if os.name != "posix":
        return []
    own = os.environ.get("NUMBA_CACHE_DIR")
    if own:
        return [Path(own)]
    folders = [source.parent / "__pycache__"]
    with suppress(RuntimeError):
        folders.append(Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "bumpytiles")
    return folders


def _fault(folder: Path) -> str | None:
    """Say why nothing can be kept in a folder; None where it can, though it may have to be made."""
    try:
        if os.path.lexists(folder):
            os.close(_open_folder(folder))
            return None if os.access(folder, os.W_OK) else "it cannot be written"
        above = next(parent for parent in folder.parents if parent.exists())
    except OSError as error:
        return error.strerror or str(error)
    return None if above.is_dir() and os.access(above, os.W_OK) else "it cannot be made"


def _open_folder(folder: Path) -> int:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    return _only_ours(descriptor)


def _only_ours(descriptor: int) -> int:
    """Close a descriptor and raise where others can have written what it stands for."""
    status = os.fstat(descriptor)
    if status.st_uid in {os.geteuid(), 0} and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return descriptor
    os.close(descriptor)
    raise PermissionError(0, "others can write to it")


def _read(file: Path) -> bytes:
    folder = _open_folder(file.parent)
    try:
        # Without O_NONBLOCK a named pipe would wait for its writer.
        descriptor = os.open(file.name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder)
    finally:
        os.close(folder)
    with open(_only_ours(descriptor), "rb") as data:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(0, "it is not a file")
        return data.read()


def _write(file: Path, content: bytes) -> None:
    folder = _open_folder(file.parent)
    try:
        part = f".{file.name}.{uuid4().hex}"
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o644, dir_fd=folder)
        try:
            with open(descriptor, "wb") as data:  # noqa: PTH123 (the same)
                data.write(content)
            os.replace(part, file.name, src_dir_fd=folder, dst_dir_fd=folder)
        except BaseException:
            os.unlink(part, dir_fd=folder)
            raise
    finally:
        os.close(folder)


_said: list[str] = []


def _say_once(where: str) -> None:
    if _said:
        return
    _said.append(where)
    _log.warning(
        "the numerical kernels are compiled in every run, which takes many seconds, because they cannot be cached%s. "
        "Set NUMBA_CACHE_DIR to a folder of your own that nobody else can write to",
        f": {where}" if where else "",
    )


@cache
def _own_source() -> list[bytes]:
    """Give the source of what makes machine code."""
    return [Path(__file__).with_name(name).read_bytes() for name in ("_compiler.py", "native.py")]


_SAFE_PATH = "PYTHONSAFEPATH"


def start_python(
    arguments: Sequence[str], *, isolated: bool = False, environment: Mapping[str, str] | None = None, **settings: Any
) -> "subprocess.Popen[bytes]":
    """Start this Python without input; its path is the same but for the current folder.

    Parameters
    ----------
    arguments : sequence of str
    isolated : bool
        Leave out site-packages and Python's environment variables too.
    environment : mapping, optional
        Environment variables to add to those of this process.
    **settings
        Those of `subprocess.Popen`.
    """
    flags = ("-I", "-S") if isolated else ("-P",)
    return subprocess.Popen(  # noqa: S603 (this Python)
        [sys.executable, *flags, *arguments],
        stdin=subprocess.DEVNULL,
        env={**os.environ, _SAFE_PATH: "1", **(environment or {})},
        **settings,
    )


@contextmanager
def blocked_signals() -> Iterator[None]:
    """Block SIGINT and SIGTERM during the body; threads and processes that it starts keep them blocked.

    Both signals reach every process of a terminal or a batch job, but only the main process handles them, and stops
    its workers. A process that receives one while it imports, starts or stops would end with a traceback.
    """
    if os.name != "posix":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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
    env = {"PYTHONPATH": os.pathsep.join(str(Path(path).absolute()) for path in sys.path if path), "NUMBA_OPT": "0"}
    with suppress(OSError):
        return start_python(
            ["-c", code, *modules],
            environment=env,
            cwd=Path(__file__).parent,  # in the current folder numba would read settings
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
    return None
