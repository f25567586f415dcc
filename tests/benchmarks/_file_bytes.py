"""Count the bytes that a command and its child processes read from each file, with strace.

A file that is mapped into memory counts as read in full by each mapping.
"""

import re
import shutil
import subprocess
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from _measure import files_of, user_environment

__all__ = ["FileBytes", "bytes_of", "count_file_bytes", "parse_traces"]

_READS = ("read", "pread64", "readv", "preadv", "preadv2", "copy_file_range")
_WRITES = ("write", "pwrite64", "writev", "pwritev", "pwritev2")
_CALL = re.compile(r"(?:\[pid +\d+\] )?(\w+)\((?:\d+<(/[^>]*)>)?")
_MAPPING = re.compile(r"mmap\([^,]+, (\d+), [^,]+, [^,]+, \d+<(/[^>]*)>")
_SENT = re.compile(r"sendfile\w*\(\d+<[^>]*>, \d+<(/[^>]*)>")
_RESULT = re.compile(r"= (\d+)(?: |$)")


@dataclass(slots=True)
class FileBytes:
    """What a command did with a file."""

    read: int = 0
    """Bytes returned by reading."""
    mapped: int = 0
    """Bytes of all mappings into memory."""
    written: int = 0
    """Bytes given to writing."""


def count_file_bytes(command: Sequence[str]) -> dict[str, FileBytes] | None:
    """Run a command under strace; return the bytes by path, None if there is no strace here or it may not trace."""
    strace = shutil.which("strace")
    if strace is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        calls = ",".join((*_READS, *_WRITES, "sendfile", "mmap"))
        options = ["-ff", "--seccomp-bpf", "-y", "-qq", "-s", "0", "-e", f"trace={calls}", "-e", "signal=none"]
        done = subprocess.run(
            [strace, *options, "-o", f"{folder}/trace", *command],
            env=user_environment(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=False,
        )
        traces = sorted(Path(folder).iterdir())
        if done.returncode != 0 or not traces:
            return None
        return parse_traces(line for trace in traces for line in trace.read_text(errors="replace").splitlines())


def parse_traces(lines: Iterable[str]) -> dict[str, FileBytes]:
    """Sum up the lines of strace by path; calls that failed or are not about files do not count."""
    files: defaultdict[str, FileBytes] = defaultdict(FileBytes)
    for line in lines:
        call = _CALL.match(line)
        result = _RESULT.search(line, line.rfind(")"))
        if call is None:
            continue
        name, path = call.groups()
        if name == "mmap" and (mapping := _MAPPING.match(line)) and "= -1" not in line:
            files[mapping[2]].mapped += int(mapping[1])
        elif name == "sendfile" and result and (source := _SENT.match(line)):
            files[source[1]].read += int(result[1])
        elif path is None or result is None:
            continue
        elif name in _READS:
            files[path].read += int(result[1])
        elif name in _WRITES:
            files[path].written += int(result[1])
    return dict(files)


def bytes_of(survey: Path, files: Mapping[str, FileBytes]) -> int:
    """Return the bytes read and mapped of all files of a survey."""
    own = (files.get(str(path.resolve()), FileBytes()) for path in files_of(survey))
    return sum(each.read + each.mapped for each in own)
