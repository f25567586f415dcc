"""Memory of a run: sizes as users type them, and what is free."""

import ctypes
import re
import resource
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from bumpymap.core.errors import UsageError

LEAST_MEMORY = 128 << 20
"""Smallest limit, bytes: one chunk of a file alone needs this much."""
_FREE_SHARE = 0.25
"""Share of the free memory that ``auto`` takes."""
_LEAST_AUTO, _MOST_AUTO = 512 << 20, 8 << 30
"""Limits of ``auto`` for each process, bytes."""
_UNITS = {"": 1, "b": 1, "kb": 1 << 10, "mb": 1 << 20, "gb": 1 << 30, "tb": 1 << 40}

_PROC, _CGROUPS = Path("/proc"), Path("/sys/fs/cgroup")
"""Where Linux shows processes, and control groups."""
_V1 = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
_V2 = ("memory.max", "memory.current", "inactive_file")
"""Files of a control group with its limit and its use, bytes, and the entry of ``memory.stat`` with the part of the use
that is copies of files, which the system gives up when memory is needed."""


_ARENA_MAX = -8
"""Of glibc's ``mallopt``."""


def limit_arenas(threads: int) -> None:
    """Let glibc keep freed memory in as many arenas as threads work at a time, not in eight times as many as cores."""
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).mallopt(_ARENA_MAX, threads)


def return_memory() -> None:
    """Give the memory of freed arrays back to the system, which glibc keeps for later ones."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def memory_bytes(text: str) -> int:
    """Parse a size such as ``1GB`` or ``800 MB`` and return it in bytes (1 GB = 2^30 bytes).

    Raises UsageError: the text is not a size, or less than ``LEAST_MEMORY``.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kmgt]?i?b?)\s*", text.lower())
    unit = found[2].replace("i", "") if found else ""
    size = float(found[1]) * _UNITS.get(unit if unit.endswith("b") or not unit else f"{unit}b", 0) if found else 0.0
    if size < LEAST_MEMORY:
        least = f"at least {LEAST_MEMORY >> 20} MB"
        raise UsageError(f"`memory` is {text!r}; it must be a size of {least}, such as 1GB or 800MB, or auto")
    return int(size)


def is_auto(text: str) -> bool:
    """Return whether a limit is ``auto``."""
    return text.strip().lower() == "auto"


def auto_memory(processes: int = 1) -> int:
    """Return the limit that ``auto`` means at this moment, for each of some processes, bytes.

    It is a quarter of the free memory, divided by the processes, at least 512 MB and at most 8 GB; 1 GB if the system
    does not say what is free.
    """
    free = free_memory()
    return 1 << 30 if free is None else min(max(int(_FREE_SHARE * free / processes), _LEAST_AUTO), _MOST_AUTO)


def memory_limit(text: str) -> int:
    """Return a limit in bytes, of a size or of ``auto``. Raises UsageError if the text is neither."""
    return auto_memory() if is_auto(text) else memory_bytes(text)


def free_memory() -> int | None:
    """Return the bytes that this process may still use; None if the system does not say.

    This is the least of what Linux calls available, of what is left in each control group of the process, and of what
    its own limits (``ulimit``) leave it.
    """
    found = [*_left_in_groups(), *_left_in_limits()]
    with suppress(OSError, ValueError, KeyError):
        found.append(_numbers(_PROC / "meminfo")["MemAvailable:"] * 1024)
    return max(min(found), 0) if found else None


def _left_in_limits() -> Iterator[int]:
    """Yield the bytes that are left of each limit of this process alone."""
    with suppress(OSError, ValueError, KeyError):
        for limit, use in ((resource.RLIMIT_AS, "VmSize:"), (resource.RLIMIT_DATA, "VmData:")):
            most = resource.getrlimit(limit)[0]
            if most != resource.RLIM_INFINITY:
                yield most - _numbers(_PROC / "self" / "status")[use] * 1024


def _left_in_groups() -> Iterator[int]:
    """Yield the bytes that are left in each control group of this process that has a limit."""
    for folder, names in _groups():
        limit, use, files = names
        with suppress(OSError, ValueError):  # no such file, or the limit is "max"
            most = int((folder / limit).read_text("ascii"))
            used = int((folder / use).read_text("ascii"))
            reclaimable = 0
            with suppress(OSError, ValueError):
                reclaimable = _numbers(folder / "memory.stat").get(files, 0)
            yield most - max(used - reclaimable, 0)


def _groups() -> Iterator[tuple[Path, tuple[str, str, str]]]:
    """Yield the folders of the control groups, from that of this process up to the root, and the names of their files.

    In a container the folder of the process may not exist, because the path is that on the host; the limits of the
    container are then in the root.
    """
    try:
        lines = (_PROC / "self" / "cgroup").read_text("utf-8").splitlines()
    except (OSError, ValueError):
        return
    for line in lines:
        number, controllers, path = line.split(":", 2)
        if "memory" in controllers.split(","):
            roots, names = [_CGROUPS / "memory"], _V1
        elif number == "0":
            roots, names = [_CGROUPS, _CGROUPS / "unified"], _V2
        else:
            continue
        inner = Path(path.lstrip("/"))
        for root in roots:
            for folder in (inner, *inner.parents):
                if ".." not in folder.parts:  # outside of what the container shows
                    yield root / folder, names


def _numbers(path: Path) -> dict[str, int]:
    """Return the lines of a file that consist of a name and a number (and a unit)."""
    rows = (line.split() for line in path.read_text("ascii").splitlines())
    return {row[0]: int(row[1]) for row in rows if len(row) > 1 and row[1].isdecimal()}
