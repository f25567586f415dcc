"""From a kernel to machine code (numba and LLVM), and from machine code to an address (LLVM alone)."""

import ctypes
import hashlib
import importlib.util
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from inspect import signature
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args, get_origin

import numpy as np

__all__ = ["Code", "KernelSource", "Options", "compile_source", "jit", "link", "linkable", "machine", "versions"]

Options = Mapping[str, Any]
Helpers = Mapping[Callable[..., Any], Options]

_OPTIONS = {"error_model": "numpy"}
_INSIDE = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of what only compiled code calls; saves a fifth of the time."""
_LIBM = frozenset({"acos", "erfc", "exp", "fmax", "fmin", "log", "memcpy", "memmove", "memset", "pow", "sqrt"})
"""What machine code may call outside itself."""


class Code(NamedTuple):
    """Machine code of a kernel."""

    symbol: str
    outside: list[str]
    """What it calls outside itself."""
    code: bytes
    """An object file."""


class Leaf(NamedTuple):
    """A number, or an array where it has dimensions."""

    name: str
    dtype: np.dtype[Any]
    dims: int

    @classmethod
    def of(cls, name: str, annotation: Any) -> "Leaf":
        """Read an annotation."""
        if get_origin(annotation) is not Annotated:
            return cls(name, np.dtype(annotation), 0)
        array, dims = get_args(annotation)
        return cls(name, np.dtype(get_args(get_args(array)[1])[0]), dims)


class Parameter(NamedTuple):
    """A parameter of a kernel."""

    group: type[Any] | None
    """The NamedTuple that it is; None for a leaf."""
    leaves: list[Leaf]


@dataclass(frozen=True)
class KernelSource:
    """A kernel as it is compiled. Its C function takes the lengths of all arrays, then a value for each leaf."""

    function: Callable[..., Any]
    parameters: list[Parameter]
    called: list[Callable[..., Any]]
    """The function and all helpers below it."""

    @classmethod
    def of(cls, function: Callable[..., Any], helpers: Helpers) -> "KernelSource":
        """Read a function's annotations and find what it calls."""
        parameters = [_parameter(name, each.annotation) for name, each in signature(function).parameters.items()]
        called = [function]
        for one in called:  # grows on the way
            below = (value for _, value in _globals(one) if callable(value) and value in helpers)
            called += [value for value in dict.fromkeys(below) if value not in called]
        return cls(function, parameters, called)

    @property
    def name(self) -> str:
        """Name of the function."""
        return self.function.__name__

    @property
    def file(self) -> Path:
        """Where the function stands."""
        return Path(self.function.__code__.co_filename)

    @property
    def size(self) -> int:
        """How long it will take to compile, in bytes of bytecode."""
        return sum(len(each.__code__.co_code) for each in self.called)

    def parts(self) -> Iterator[bytes]:
        """Everything that its machine code depends on, compiler and processor aside."""
        yield repr([[tuple(map(str, leaf)) for leaf in each.leaves] for each in self.parameters]).encode()
        for each in self.called:
            yield Path(each.__code__.co_filename).read_bytes()
            numbers = [pair for pair in _globals(each) if isinstance(pair[1], int | float | tuple | np.generic)]
            yield repr(numbers).encode()

    @property
    def leaves(self) -> list[Leaf]:
        """All numbers and arrays."""
        return [leaf for each in self.parameters for leaf in each.leaves]

    @property
    def c_types(self) -> list[Any]:
        """Types of the C function's arguments."""
        numbers = np.ctypeslib.as_ctypes_type
        return [ctypes.c_void_p, *(ctypes.c_void_p if x.dims else numbers(x.dtype) for x in self.leaves)]

    def c_arguments(self, arguments: tuple[Any, ...]) -> Iterator[Any]:
        """Turn the kernel's arguments into those of the C function; raises TypeError where one does not fit."""
        if len(arguments) != len(self.parameters):
            raise TypeError(f"{self.name} takes {len(self.parameters)} arguments, not {len(arguments)}")
        lengths: list[int] = []
        values: list[Any] = []
        for argument, (group, leaves) in zip(arguments, self.parameters, strict=True):
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

    def c_source(self) -> str:
        """Write the C function in Python: it puts arrays and NamedTuples together and calls the kernel."""
        names: list[str] = []
        arguments: list[str] = []
        lengths = 0
        for place, (group, leaves) in enumerate(self.parameters):
            values = []
            for leaf in leaves:
                names.append(f"v{len(names)}")
                shape = "".join(f"lengths[{lengths + axis}], " for axis in range(leaf.dims))
                values.append(f"carray({names[-1]}, ({shape}))" if leaf.dims else names[-1])
                lengths += leaf.dims
            arguments.append(f"group{place}({', '.join(values)})" if group else values[0])
        return f"def c_function(lengths, {', '.join(names)}):\n    kernel({', '.join(arguments)})\n"


def _parameter(name: str, annotation: Any) -> Parameter:
    if isinstance(annotation, type) and issubclass(annotation, tuple):
        return Parameter(annotation, [Leaf.of(field, kind) for field, kind in annotation.__annotations__.items()])
    return Parameter(None, [Leaf.of(name, annotation)])


def _globals(function: Callable[..., Any]) -> list[tuple[str, Any]]:
    """List the global names that a function uses, with their values."""
    own = function.__globals__
    return [(name, own[name]) for name in function.__code__.co_names if name in own]


def jit(function: Callable[..., Any], helpers: Helpers) -> Any:
    """Return a function that numba compiles when it is called from Python."""
    from numba import njit

    _register(helpers)
    return njit(**_OPTIONS, **helpers.get(function, {}))(function)


def compile_source(source: KernelSource, helpers: Helpers) -> Code:
    """Compile a kernel; raises TypeError where it needs more than itself and libm."""
    from numba import carray, cfunc, from_dtype, types

    _register({**helpers, source.function: {}})
    plain = [(from_dtype(leaf.dtype), leaf.dims) for leaf in source.leaves]
    kinds = [types.CPointer(kind) if dims else kind for kind, dims in plain]
    names = {"carray": carray, "kernel": source.function}
    names |= {f"group{place}": each.group for place, each in enumerate(source.parameters)}
    exec(source.c_source(), names)  # noqa: S102 (of names and numbers alone)
    compiled = cfunc(types.void(types.CPointer(types.intp), *kinds), **_OPTIONS)(names["c_function"])
    module = _alone(compiled.inspect_llvm(), compiled.native_name)
    outside = {f.name for f in module.functions if f.is_declaration and not f.name.startswith("llvm.")}
    outside |= {g.name for g in module.global_variables if g.is_declaration}
    if not linkable(outside):
        raise TypeError(f"the kernel {source.name} cannot be kept: it calls {', '.join(sorted(outside))}")
    # All kernels are linked together, and numba's names of two with equal parameters may be the same.
    symbol = f"{source.name}_{hashlib.sha256(str(module).encode()).hexdigest()}"
    module.get_function(compiled.native_name).name = symbol
    code: bytes = _target().emit_object(module)
    return Code(symbol, sorted(outside), code)


_registered: set[Callable[..., Any]] = set()


def _register(helpers: Helpers) -> None:
    """Tell numba of helpers."""
    from numba.extending import register_jitable

    for function, options in helpers.items():
        if function not in _registered:
            _registered.add(function)
            register_jitable(**_OPTIONS, **_INSIDE, **options)(function)


def _alone(text: str, symbol: str) -> Any:
    """Parse a module, optimise it, and leave of it what one function needs."""
    llvm = _llvm()
    module = llvm.parse_assembly(text)
    # Reference counts of arrays that Python owns stay untouched; the call behind them is never reached.
    module.link_in(llvm.parse_assembly("define void @NRT_MemInfo_call_dtor(ptr %info) { ret void }"))
    for function in module.functions:
        if not function.is_declaration and function.name != symbol:
            function.linkage = "internal"
    # What numba does with a whole library: bring loops into the form that vectorises, drop pairs of reference counts.
    _optimise(
        module, lambda passes: passes.add_loop_rotate_pass(), lambda passes: passes.add_instruction_combine_pass()
    )
    # A kernel raises nothing; with that known, what would print an exception is dead.
    _optimise(
        module,
        lambda passes: passes.add_ipsccp_pass(),
        lambda passes: passes.add_simplify_cfg_pass(),
        lambda passes: passes.add_global_dead_code_eliminate_pass(),
        lambda passes: passes.add_strip_dead_prototype_pass(),
    )
    return module


def _optimise(module: Any, *more: Callable[[Any], None]) -> None:
    """Run LLVM's passes of level 3 over a module, and more passes after them."""
    llvm = _llvm()
    tuning = llvm.create_pipeline_tuning_options(speed_level=3)
    tuning.loop_vectorization = tuning.slp_vectorization = True
    builder = llvm.create_pass_builder(_target(), tuning)
    passes = builder.getModulePassManager()
    for add in more:
        add(passes)
    passes.add_refprune_pass()
    passes.run(module, builder)


@cache
def _llvm() -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm


@cache
def machine() -> bytes:
    """Say which processor this is."""
    llvm = _llvm()
    return f"{llvm.get_process_triple()} {llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}".encode()


@cache
def versions() -> bytes:
    """Say which compiler would be at work, without importing it."""
    import llvmlite

    spec = importlib.util.find_spec("numba")
    numba = Path(spec.origin).with_name("_version.py") if spec is not None and spec.origin else None
    stated = numba.read_bytes() if numba is not None and numba.is_file() else b""
    own: bytes = llvmlite.__version__.encode()
    return own + stated


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


def linkable(outside: Iterable[str]) -> bool:
    """Tell the linker where libm is; False where something else is wanted (the linker would end the process)."""
    process = ctypes.CDLL("ucrtbase" if os.name == "nt" else None)
    for name in outside:
        if name not in _LIBM or not hasattr(process, name):
            return False
        _llvm().add_symbol(name, ctypes.cast(getattr(process, name), ctypes.c_void_p).value)
    return True


_linking = threading.Lock()
_linked: dict[str, int] = {}
"""Addresses of what is linked, by symbol."""


@cache
def _engine() -> Any:
    """Hold the machine code of all kernels in memory for as long as the process lives; an engine takes 1 ms to make."""
    return _llvm().create_mcjit_compiler(_llvm().parse_assembly(""), _target())


def link(code: Code) -> int:
    """Load machine code; returns the address of its C function."""
    with _linking:
        if code.symbol not in _linked:
            _engine().add_object_file(_llvm().ObjectFileRef.from_data(code.code))
            _engine().finalize_object()
            _linked[code.symbol] = int(_engine().get_function_address(code.symbol))
        return _linked[code.symbol]
