"""How much memory is free to this process: on the machine, and below the limits of its control groups (containers)."""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

__all__ = ["free_memory"]

_PROC, _CGROUPS = Path("/proc"), Path("/sys/fs/cgroup")
_V1 = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
_V2 = ("memory.max", "memory.current", "inactive_file")
"""Files of a control group with its limit and its use, bytes, and the entry of ``memory.stat`` with the part of the use
that is copies of files, which the system gives up when memory is needed."""


def free_memory(proc: Path = _PROC, cgroups: Path = _CGROUPS) -> int | None:
    """Return the bytes that this process may still use; None if the system does not say.

    This is the least of what Linux calls available and of what is left in each control group of the process. Systems
    without ``/proc/meminfo`` give their installed memory.

    Parameters
    ----------
    proc, cgroups : Path
        Where Linux shows processes, and control groups.
    """
    found = [*_available(proc), *_left_in_groups(proc, cgroups)]
    return max(min(found), 0) if found else _installed()


def _available(proc: Path) -> Iterator[int]:
    with suppress(OSError, ValueError, KeyError):
        yield _numbers(proc / "meminfo")["MemAvailable:"] * 1024


def _installed() -> int | None:
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return None


def _left_in_groups(proc: Path, cgroups: Path) -> Iterator[int]:
    """Yield the bytes that are left in each control group of this process that has a limit."""
    for folder, names in _groups(proc, cgroups):
        limit, use, files = names
        with suppress(OSError, ValueError):  # no such file, or the limit is "max"
            most = int((folder / limit).read_text("ascii"))
            used = int((folder / use).read_text("ascii"))
            reclaimable = 0
            with suppress(OSError, ValueError):
                reclaimable = _numbers(folder / "memory.stat").get(files, 0)
            yield most - max(used - reclaimable, 0)


def _groups(proc: Path, cgroups: Path) -> Iterator[tuple[Path, tuple[str, str, str]]]:
    """Yield the folders of the control groups, from that of this process up to the root, and the names of their files.

    In a container the folder of the process may not exist, because the path is that on the host; the limits of the
    container are then in the root.
    """
    try:
        lines = (proc / "self" / "cgroup").read_text("utf-8").splitlines()
    except (OSError, ValueError):
        return
    for line in lines:
        number, controllers, path = line.split(":", 2)
        if "memory" in controllers.split(","):
            roots, names = [cgroups / "memory"], _V1
        elif number == "0":
            roots, names = [cgroups, cgroups / "unified"], _V2
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
