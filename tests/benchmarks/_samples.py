"""Sample a command and its child processes with perf, and say in which part of the program the processor was.

The compiled kernels of bumpymap are machine code in memory that belongs to no file, which perf reports as a map file
or as JIT; nothing else that ``bumpymap map`` uses makes machine code.
"""

import re
import shutil
import subprocess
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from _measure import user_environment

__all__ = ["KERNELS", "kernel_part", "part_of", "sample", "samples_in"]

KERNELS = "compiled kernels"
_FREQUENCY = 499
"""Samples per second and core; a prime number, so that it keeps no step with anything periodic."""
_HEAD = re.compile(r"^\s*[0-9a-f]+ (.*) \(([^()]*(?:\([^()]*\))?[^()]*)\)$")
"""A line of perf script: address, symbol, file."""
_PACKAGE = re.compile(r"/(?:site|dist)-packages/([A-Za-z0-9_]+)(?:\.libs)?/")
_PACKAGES = {
    "rasterio": "rasterio and its GDAL",
    "pyogrio": "pyogrio and its GDAL",
    "numpy": "numpy",
    "pyarrow": "pyarrow",
    "shapely": "shapely and GEOS",
    "pyproj": "pyproj and PROJ",
}
_FILES = (
    ("libpython", "Python interpreter"),
    ("python3", "Python interpreter"),
    ("libcrypto", "hashlib (OpenSSL)"),
    ("libz.", "zlib"),
    ("libm.", "libm"),
    ("ld-linux", "dynamic loader"),
    ("ld-musl", "dynamic loader"),
    ("libstdc++", "C++ library"),
)
_COPIES = re.compile(r"mem(cpy|move|set|cmp|chr)|bcopy|bzero")
_ALLOCATIONS = re.compile(r"malloc|calloc|realloc|free|memalign|unlink_chunk|sysmalloc|systrim|mtrim|tcache|arena")
_KERNEL_PARTS = (
    ("page faults", ("exc_page_fault", "do_user_addr_fault")),
    ("memory given back", ("exit_mmap", "munmap", "madvise", "do_exit", "exit_mm")),
    ("reading files", ("vfs_read", "ksys_read", "filemap_read", "pread64", "preadv", "readv", "sendfile")),
    ("writing files", ("vfs_write", "ksys_write", "pwrite64", "fsync", "fdatasync", "sync_file_range", "rename")),
    ("names of files", ("openat", "newfstatat", "statx", "getdents", "readlink", "unlink", "path_lookupat")),
    ("start of processes", ("execve", "clone", "do_fork", "kernel_clone")),
)
"""Part of the kernel -> functions of which one is in the call chain; the first that fits counts."""


def sample(command: Sequence[str]) -> Counter[str] | None:
    """Run a command under perf; return the samples by part, None if there is no perf here or it may not sample."""
    perf = shutil.which("perf")
    if perf is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder) / "samples")
        options = ["-e", "cpu-clock", "-F", str(_FREQUENCY), "-g", "--kernel-callchains", "-q", "-o", file]
        record = [perf, "record", *options, "--", *command]
        done = subprocess.run(
            record, env=user_environment(), stdin=subprocess.DEVNULL, capture_output=True, check=False
        )
        if done.returncode != 0:
            return None
        heads = _script(perf, file, "-G")
        return samples_in(heads, _chains(_script(perf, file)))


def _script(perf: str, file: str, *options: str) -> list[str]:
    """Return the lines of perf script."""
    script = [perf, "script", "-i", file, "-F", "pid,ip,sym,dso", "--no-inline", *options]
    return subprocess.run(script, capture_output=True, text=True, errors="replace", check=True).stdout.splitlines()


def _chains(lines: Iterable[str]) -> Iterator[str]:
    """Yield the call chain of each sample as one text; samples end with an empty line."""
    chain: list[str] = []
    for line in lines:
        if line.strip():
            chain.append(line)
        elif chain:
            yield " ".join(chain)
            chain = []
    if chain:
        yield " ".join(chain)


def samples_in(heads: Iterable[str], chains: Iterable[str]) -> Counter[str]:
    """Count samples by part.

    Parameters
    ----------
    heads : lines of perf script without call chains: process, address, symbol, file
    chains : call chains in the kernel of the same samples
    """
    found: Counter[str] = Counter()
    for head, chain in zip((head for head in heads if head.strip()), chains, strict=True):
        place = _HEAD.match(head.strip().partition(" ")[2])
        symbol, file = place.groups() if place else ("", "")
        part = part_of(file, symbol)
        found[f"operating system: {kernel_part(chain)}" if part == "operating system" else part] += 1
    return found


def part_of(file: str, symbol: str) -> str:
    """Return the part of the program that a sample belongs to, from the file of its code and its function."""
    name = file.rpartition("/")[2]
    package = _PACKAGE.search(file)
    if file.startswith(("[kernel", "[guest.kernel", "[vdso]")) or (file.startswith("[") and file.endswith(".ko]")):
        part = "operating system"
    elif re.fullmatch(r"perf-\d+\.map", name) or file.startswith(("[JIT]", "//anon", "[anon")):
        part = KERNELS
    elif package:
        part = _PACKAGES.get(package[1], package[1])
    elif "/lib-dynload/" in file:
        part = "Python interpreter"
    elif name.startswith(("libc.so", "libc-", "libc.musl")):
        memory = "libc: memory allocated, freed" if _ALLOCATIONS.search(symbol) else "libc: other"
        part = "libc: memory copied, set, compared" if _COPIES.search(symbol) else memory
    else:
        part = next((part for start, part in _FILES if name.startswith(start)), name or "unknown")
    return part


def kernel_part(chain: str) -> str:
    """Return what the kernel did, from the functions in a call chain."""
    for part, functions in _KERNEL_PARTS:
        if any(function in chain for function in functions):
            return part
    return "other"
