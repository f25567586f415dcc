"""Compiled kernels that start without their compiler.

numba is the compiler, and importing it and its cache takes longer than many a map. So no kernel module imports it:

- `helper` and `kernel` leave a function plain Python. A kernel compiles when it is called for the first time, or finds
  its machine code in a cache.
- To compile, numba is told of all helpers (``register_jitable``), so that kernels call helpers of any module, and makes
  the kernel a C function (``cfunc``), its documented door for callers that are not numba.
- LLVM alone optimises that function, writes it to the cache, and loads it in later runs; ctypes calls it.

A package ships the machine code of its kernels for x86-64 processors since 2013 (x86-64-v3). Only kernels whose source
was changed, or all of them on another processor, are compiled: in processes beside the run, for all kernel modules at
once, which takes less time, and the memory that a compiler needs is not taken from the run. A warning says so.

What that asks of a kernel: annotated parameters and no result. A parameter is a number, an array
(``Annotated[NDArray[np.float64], 2]``: two dimensions, C-contiguous) or a NamedTuple of these. No allocation, no
exceptions, no calls but to helpers and to libm.

*Files of machine code.* Whoever can change a file of machine code decides what its reader runs. So a file counts only
where nobody but the user or root can have written it: both own it and its folder, nobody else may write to either, and
neither is a link. All else is as if it were not there, and nothing is kept where it would not count. What a package
ships is trusted as its Python code is.

*Processes.* Python puts the current folder, where strangers' files may lie, on the path of ``python -c`` and so of what
`multiprocessing` starts. No process that is started here has it there, nor has any that those start.
"""

import ctypes
import gc
import hashlib
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
from inspect import signature
from pathlib import Path
from typing import Annotated, Any, Generic, NamedTuple, ParamSpec, TypeVar, get_args, get_origin
from uuid import uuid4

import numpy as np

_log = logging.getLogger(__name__)

_OPTIONS = {"error_model": "numpy"}
_INSIDE = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of what only compiled code calls; saves a fifth of the time."""
_LIBM = frozenset({"acos", "erfc", "exp", "fmax", "fmin", "log", "memcpy", "memmove", "memset", "pow", "sqrt"})
"""Functions that machine code may call outside itself."""
_HEAD = 2 * hashlib.sha256().digest_size
"""Bytes before the machine code in a file: the key of what it must be of, and the digest of the code."""
_COMMON = {"avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"}
"""Features that x86-64-v3 adds to older processors."""

P = ParamSpec("P")
F = TypeVar("F", bound=Callable[..., Any])

_helpers: dict[Callable[..., Any], Mapping[str, Any]] = {}
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


def kernel(function: Callable[P, None]) -> "Kernel[P]":
    """Mark a function that Python calls as compiled code; see the module for what it may do."""
    return Kernel(function)


class Leaf(NamedTuple):
    """A number, or an array where it has dimensions."""

    name: str
    dtype: np.dtype[Any]
    dims: int


class Kernel(Generic[P]):
    """A compiled function that Python calls; its C function takes the lengths of all arrays, then a value a leaf.

    Its machine code is kept in one file for each kind of processor, which is replaced when it is stale.

    Parameters
    ----------
    function : callable
        The plain function.
    """

    def __init__(self, function: Callable[P, None]) -> None:
        self.plain, self.name = function, function.__name__
        self._call: Callable[..., None] | None = None
        _kernels.setdefault(function.__module__, []).append(self)

    def __call__(self, *arguments: P.args, **named: P.kwargs) -> None:
        """Run the machine code; the interpreter's lock is free meanwhile."""
        if named:
            raise TypeError(f"{self.name} takes its arguments by position")
        if self._call is None:
            self._call = self._ready()
        self._call(*self._c_arguments(arguments))

    def _ready(self) -> Callable[..., None]:
        code = self.load()
        if code is None and self.can_keep():
            _compile_beside()
            code = self.load()
        if code is None:
            code = self.compile()
            self.save(code)
        kinds = [ctypes.c_void_p if leaf.dims else np.ctypeslib.as_ctypes_type(leaf.dtype) for leaf in self._leaves]
        return ctypes.CFUNCTYPE(None, ctypes.c_void_p, *kinds)(_link(self.symbol, code))

    @property
    def symbol(self) -> str:
        """Name of the C function: all kernels are linked together, and each has its own."""
        return f"{self.plain.__module__}.{self.name}"

    @cached_property
    def _parameters(self) -> list[tuple[type[Any] | None, list[Leaf]]]:
        """Each parameter: the NamedTuple that it is, or None, and its leaves."""
        found: list[tuple[type[Any] | None, list[Leaf]]] = []
        for name, parameter in signature(self.plain).parameters.items():
            kind = parameter.annotation
            group = kind if isinstance(kind, type) and issubclass(kind, tuple) else None
            fields = {name: kind} if group is None else group.__annotations__
            found.append((group, [_leaf(*field) for field in fields.items()]))
        return found

    @property
    def _leaves(self) -> list[Leaf]:
        return [leaf for _, leaves in self._parameters for leaf in leaves]

    @cached_property
    def called(self) -> list[Callable[..., Any]]:
        """The function and all helpers below it."""
        called: list[Callable[..., Any]] = [self.plain]
        for one in called:  # grows on the way
            below = (value for _, value in _globals(one) if callable(value) and value in _helpers)
            called += [value for value in dict.fromkeys(below) if value not in called]
        return called

    @cached_property
    def key(self) -> bytes:
        """Return a digest of what the machine code must be of."""
        parts = [repr([[tuple(map(str, leaf)) for leaf in leaves] for _, leaves in self._parameters]).encode()]
        for each in self.called:
            numbers = [pair for pair in _globals(each) if isinstance(pair[1], int | float | tuple | np.generic)]
            parts += [Path(each.__code__.co_filename).read_bytes(), repr(numbers).encode()]
        parts += [Path(__file__).read_bytes(), repr(_processor()).encode(), self.symbol.encode()]
        return hashlib.sha256(b"\0".join(parts)).digest()

    @property
    def shipped(self) -> Path:
        """The file of machine code that comes with the package."""
        depth = self.plain.__module__.count(".")
        return Path(self.plain.__code__.co_filename).parents[max(depth - 1, 0)] / "kernels" / self._file

    @property
    def _file(self) -> str:
        return f"{self.symbol}.{hashlib.sha256(repr(_processor()).encode()).hexdigest()[:8]}.native"

    @cached_property
    def _kept(self) -> list[Path]:
        """The files that may hold machine code which was compiled here."""
        return [folder / self._file for folder in _folders(Path(self.plain.__code__.co_filename))]

    def can_keep(self) -> bool:
        """Return whether there is a folder for the machine code; where there is none, it is said once why."""
        faults = {}
        for file in self._kept:
            try:
                with _trusted(file.parent, make=True):
                    if os.access(file.parent, os.W_OK):
                        return True
                    faults[file.parent] = "it cannot be written"
            except OSError as error:
                faults[file.parent] = error.strerror or str(error)
        _say_once(", ".join(f"{folder} ({fault})" for folder, fault in faults.items()))
        return False

    def load(self) -> bytes | None:
        """Return the machine code, an object file; None where there is none for this source and processor."""
        for read, file in [(Path.read_bytes, self.shipped), *((_read, file) for file in self._kept)]:
            with suppress(OSError):
                content = read(file)
                code = content[_HEAD:]
                if content[:_HEAD] == self.head(code):
                    return code
        return None

    def head(self, code: bytes) -> bytes:
        """Return what stands before machine code in a file."""
        return self.key + hashlib.sha256(code).digest()

    def save(self, code: bytes) -> None:
        """Keep machine code in the first folder that will do; a file appears whole or not at all."""
        for file in self._kept:
            try:
                _write(file, self.head(code) + code)
            except OSError as error:
                _log.debug("cannot keep compiled kernels in %s: %s", file.parent, error)
            else:
                return

    def compile(self) -> bytes:
        """Compile in this process; raises TypeError where the kernel needs more than itself and libm."""
        from numba import carray, cfunc, from_dtype, types

        with _compiling:
            for each in self.called:
                _register(each)
            plain = [(from_dtype(leaf.dtype), leaf.dims) for leaf in self._leaves]
            kinds = [types.CPointer(kind) if dims else kind for kind, dims in plain]
            names = {"carray": carray, "kernel": self.plain}
            names |= {f"group{place}": group for place, (group, _) in enumerate(self._parameters)}
            exec(self._c_source(), names)  # noqa: S102 (of names and numbers alone)
            compiled = cfunc(types.void(types.CPointer(types.intp), *kinds), **_OPTIONS)(names["c_function"])
            module = _alone(compiled.inspect_llvm(), compiled.native_name)
            outside = {f.name for f in module.functions if f.is_declaration and not f.name.startswith("llvm.")}
            outside |= {g.name for g in module.global_variables if g.is_declaration}
            if not outside <= _libm().keys():
                raise TypeError(f"the kernel {self.name} cannot be kept: it calls {', '.join(sorted(outside))}")
            module.get_function(compiled.native_name).name = self.symbol
            code: bytes = _target().emit_object(module)
            return code

    def _c_arguments(self, arguments: tuple[Any, ...]) -> Iterator[Any]:
        """Turn the kernel's arguments into those of the C function; raises TypeError where one does not fit."""
        if len(arguments) != len(self._parameters):
            raise TypeError(f"{self.name} takes {len(self._parameters)} arguments, not {len(arguments)}")
        lengths: list[int] = []
        values: list[Any] = []
        for argument, (group, leaves) in zip(arguments, self._parameters, strict=True):
            if group is not None and type(argument) is not group:
                raise TypeError(f"{self.name} takes a {group.__name__}, not a {type(argument).__name__}")
            for value, leaf in zip((argument,) if group is None else argument, leaves, strict=True):
                if not leaf.dims:
                    values.append(leaf.dtype.type(value).item())
                    continue
                if value.dtype != leaf.dtype or value.ndim != leaf.dims or not value.flags.c_contiguous:
                    raise TypeError(
                        f"{leaf.name} of {self.name} is {value.dtype} with {value.ndim} dimensions; "
                        f"it must be {leaf.dtype} with {leaf.dims}, C-contiguous"
                    )
                lengths += value.shape
                values.append(value.ctypes.data)
        yield (ctypes.c_ssize_t * len(lengths))(*lengths)
        yield from values

    def _c_source(self) -> str:
        """Write the C function in Python: it puts arrays and NamedTuples together and calls the kernel."""
        names: list[str] = []
        arguments: list[str] = []
        lengths = 0
        for place, (group, leaves) in enumerate(self._parameters):
            values = []
            for leaf in leaves:
                names.append(f"v{len(names)}")
                shape = "".join(f"lengths[{lengths + axis}], " for axis in range(leaf.dims))
                values.append(f"carray({names[-1]}, ({shape}))" if leaf.dims else names[-1])
                lengths += leaf.dims
            arguments.append(f"group{place}({', '.join(values)})" if group else values[0])
        return f"def c_function(lengths, {', '.join(names)}):\n    kernel({', '.join(arguments)})\n"


def _leaf(name: str, annotation: Any) -> Leaf:
    if get_origin(annotation) is not Annotated:
        return Leaf(name, np.dtype(annotation), 0)
    array, dims = get_args(annotation)
    return Leaf(name, np.dtype(get_args(get_args(array)[1])[0]), dims)


def _globals(function: Callable[..., Any]) -> list[tuple[str, Any]]:
    """List the global names that a function uses, with their values."""
    own = function.__globals__
    return [(name, own[name]) for name in function.__code__.co_names if name in own]


def _folders(source: Path) -> list[Path]:
    """Where to look, in this order: a container's user may have no home."""
    own = os.environ.get("NUMBA_CACHE_DIR")
    if own:
        return [Path(own)]
    folders = [source.parent / "__pycache__"]
    with suppress(RuntimeError):
        folders.append(Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "bumpytiles")
    return folders


@contextmanager
def _trusted(folder: Path, *, make: bool = False) -> Iterator[int]:
    """Open a folder that nobody but the user or root can have written; ``make`` one that is not there."""
    if make and not os.path.lexists(folder):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        _refuse_strangers(descriptor)
        yield descriptor
    finally:
        os.close(descriptor)


def _refuse_strangers(descriptor: int) -> None:
    """Raise where others can have written what a descriptor stands for."""
    status = os.fstat(descriptor)
    if status.st_uid not in {os.geteuid(), 0} or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise PermissionError(0, "others can write to it")


def _read(file: Path) -> bytes:
    with _trusted(file.parent) as folder:
        # Without O_NONBLOCK a named pipe would wait for its writer.
        descriptor = os.open(file.name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder)
        with open(descriptor, "rb") as data:  # noqa: PTH123 (of a descriptor)
            _refuse_strangers(descriptor)
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise OSError(0, "it is not a file")
            return data.read()


def _write(file: Path, content: bytes) -> None:
    part = f".{file.name}.{uuid4().hex}"
    with _trusted(file.parent, make=True) as folder:
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o644, dir_fd=folder)
        try:
            with open(descriptor, "wb") as data:  # noqa: PTH123 (of a descriptor)
                data.write(content)
            os.replace(part, file.name, src_dir_fd=folder, dst_dir_fd=folder)
        except BaseException:
            os.unlink(part, dir_fd=folder)
            raise


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
def _register(function: Callable[..., Any]) -> None:
    """Tell numba of a helper, or of the plain function of a kernel."""
    from numba.extending import register_jitable

    register_jitable(**_OPTIONS, **_INSIDE, **_helpers.get(function, {}))(function)


def _alone(text: str, symbol: str) -> Any:
    """Parse a module, optimise it, and leave of it what one function needs."""
    llvm = _llvm()
    module = llvm.parse_assembly(text)
    # Reference counts of arrays that Python owns stay untouched; the call behind them is never reached.
    module.link_in(llvm.parse_assembly("define void @NRT_MemInfo_call_dtor(ptr %info) { ret void }"))
    for each in (*module.functions, *module.global_variables):
        if not each.is_declaration and each.name != symbol:
            each.linkage = "internal"
    tuning = llvm.create_pipeline_tuning_options(speed_level=3)
    tuning.loop_vectorization = tuning.slp_vectorization = True
    for more in (
        # What numba does with a whole library: bring loops into the form that vectorises, drop pairs of reference
        # counts. Then: a kernel raises nothing; with that known, what would print an exception is dead.
        ("loop_rotate", "instruction_combine"),
        ("ipsccp", "simplify_cfg", "global_dead_code_eliminate", "strip_dead_prototype", "strip_symbols"),
    ):
        builder = llvm.create_pass_builder(_target(), tuning)
        passes = builder.getModulePassManager()
        for name in more:
            getattr(passes, f"add_{name}_pass")()
        passes.add_refprune_pass()
        passes.run(module, builder)
    return module


@cache
def _llvm() -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm


@cache
def _processor() -> tuple[str, str, str]:
    """Return platform, processor and features that code is made for: the common ones of x86-64 where this has them."""
    llvm = _llvm()
    platform, features = llvm.get_process_triple(), llvm.get_host_cpu_features()
    if platform.startswith("x86_64") and all(features.get(name) for name in _COMMON):
        return platform, "x86-64-v3", ""
    return platform, llvm.get_host_cpu_name(), features.flatten()


@cache
def _target() -> Any:
    platform, cpu, features = _processor()
    return (
        _llvm()
        .Target.from_triple(platform)
        .create_target_machine(cpu=cpu, features=features, opt=3, codemodel="jitdefault", jit=True)
    )


@cache
def _libm() -> dict[str, int | None]:
    """Return the functions that machine code may call outside itself, and where they are in this process."""
    process = ctypes.CDLL(None)
    there = {name: getattr(process, name) for name in _LIBM if hasattr(process, name)}
    return {name: ctypes.cast(function, ctypes.c_void_p).value for name, function in there.items()}


_linking = threading.Lock()
_linked: dict[str, int] = {}
"""Addresses of what is linked, by symbol."""


@cache
def _engine() -> Any:
    """Hold the machine code of all kernels in memory for as long as the process lives; an engine takes 1 ms to make."""
    for name, address in _libm().items():
        _llvm().add_symbol(name, address)
    return _llvm().create_mcjit_compiler(_llvm().parse_assembly(""), _target())


def _link(symbol: str, code: bytes) -> int:
    """Load machine code; returns the address of its C function."""
    with _linking:
        if symbol not in _linked:
            _engine().add_object_file(_llvm().ObjectFileRef.from_data(code))
            _engine().finalize_object()
            _linked[symbol] = int(_engine().get_function_address(symbol))
        return _linked[symbol]


def compile_modules(*modules: str) -> None:
    """Compile what the cache has not of some kernel modules, and keep it: the work of a child."""
    gc.disable()  # a compiler makes millions of objects and few cycles: 7 % of the time
    for module in modules:
        import_module(module)
        for each in _kernels.get(module, []):
            if each.load() is None:
                each.save(each.compile())


def compile_loaded() -> None:
    """Compile what is not at hand of the kernels that are loaded, before other processes need them."""
    _all_at_hand([each for kernels in _kernels.values() for each in kernels])


def compile_packages(*packages: str) -> bool:
    """Compile what is not at hand of all kernels in some packages; False where nothing can be kept."""
    return _all_at_hand(package_kernels(*packages))


def _all_at_hand(kernels: list["Kernel[Any]"]) -> bool:
    missing = [each for each in kernels if each.load() is None]
    if missing and all(each.can_keep() for each in missing):
        _compile_beside()
    return all(each.load() is not None for each in missing)


def package_kernels(*packages: str) -> list["Kernel[Any]"]:
    """Import and return all kernels in some packages."""
    names = [
        ".".join((package, *file.relative_to(folder).with_suffix("").parts))
        for package in packages
        for folder in map(Path, import_module(package).__path__)
        for file in sorted(folder.rglob("*.py"))
        if "\n@kernel\n" in file.read_text(encoding="utf-8")
    ]
    for name in names:
        import_module(name)
    return [each for name in names for each in _kernels[name]]


_compiling_beside = threading.Lock()
_tried: set[str] = set()
"""Modules that were compiled beside this process, or had nothing to compile."""


def _compile_beside() -> None:
    """Compile the loaded kernel modules in other processes, as many as there are cores; one may fail."""
    with _compiling_beside:
        missing = {
            name: [each for each in own if each.load() is None] for name, own in _kernels.items() if name not in _tried
        }
        _tried.update(missing)
        # How long it takes goes with the bytes of bytecode.
        size = {
            name: sum(len(called.__code__.co_code) for each in own for called in each.called)
            for name, own in missing.items()
        }
        shares: list[list[str]] = [[] for _ in range(os.cpu_count() or 1)]
        for name in sorted(filter(size.get, size), key=lambda name: -size[name]):
            min(shares, key=lambda share: sum(size[held] for held in share)).append(name)
        children = [child for child in map(_start, filter(None, shares)) if child is not None]
        if children:
            total = sum(map(len, missing.values()))
            plural = "s" * (total > 1)
            _log.warning("compiling %d numerical kernel%s, once; this takes up to two minutes", total, plural)
        for child in children:
            child.wait()


def _start(modules: list[str]) -> subprocess.Popen[bytes] | None:
    """Start a child; None where that cannot be done."""
    code = f"import sys; from {__name__} import compile_modules; compile_modules(*sys.argv[1:])"
    # Helpers are optimised once, as parts of a kernel, not by numba before that.
    env = {"PYTHONPATH": os.pathsep.join(str(Path(path).absolute()) for path in sys.path if path), "NUMBA_OPT": "0"}
    output: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with suppress(OSError):
        # Not in the current folder, where numba would read settings.
        return start_python(["-c", code, *modules], environment=env, cwd=Path(__file__).parent, **output)
    return None


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
        env={**os.environ, "PYTHONSAFEPATH": "1", **(environment or {})},
        **settings,
    )


@contextmanager
def blocked_signals() -> Iterator[None]:
    """Block SIGINT and SIGTERM during the body; threads and processes that it starts keep them blocked.

    Both signals reach every process of a terminal or a batch job, but only the main process handles them, and stops
    its workers. A process that receives one while it imports, starts or stops would end with a traceback.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
