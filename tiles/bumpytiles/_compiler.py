"""What numba and LLVM do for ``bumpytiles.native``: from an entry to machine code, from machine code to an address."""

import ctypes
import importlib.util
import logging
import os
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

__all__ = ["Code", "compile_entry", "found", "link", "machine", "versions"]

_log = logging.getLogger(__name__)
_FORMAT = 2
_LIBM = frozenset({"acos", "erfc", "exp", "fmax", "fmin", "log", "memcpy", "memmove", "memset", "pow", "sqrt"})
"""What machine code may call outside itself."""


class Code(NamedTuple):
    """Machine code of one entry."""

    symbol: str
    outside: list[str]
    """What it calls outside itself."""
    code: bytes
    """An object file."""


@cache
def _llvm() -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm


def machine() -> bytes:
    """Say which processor this is."""
    llvm = _llvm()
    return f"{llvm.get_process_triple()} {llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}".encode()


def versions() -> bytes:
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


def compile_entry(dispatcher: Any, kinds: list[tuple[np.dtype[Any], int]]) -> Code | None:
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
    if not found(outside):
        _log.debug("%s is compiled in every run: it calls %s", symbol, ", ".join(sorted(outside)))
        return None
    return Code(symbol, sorted(outside), _target().emit_object(module))


def found(outside: Iterable[str]) -> bool:
    """Tell the linker where libm is; False where something else is wanted (the linker would end the process)."""
    process = ctypes.CDLL("ucrtbase" if os.name == "nt" else None)
    for name in outside:
        if name not in _LIBM or not hasattr(process, name):
            return False
        _llvm().add_symbol(name, ctypes.cast(getattr(process, name), ctypes.c_void_p).value)
    return True


_engines: list[Any] = []
"""Hold the machine code in memory for as long as the process lives."""


def link(code: Code) -> int:
    """Load machine code; returns the address of its entry."""
    llvm = _llvm()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code.code))
    engine.finalize_object()
    _engines.append(engine)
    return int(engine.get_function_address(code.symbol))
