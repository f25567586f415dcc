"""Child process of the hostile corpus: runs the command line again and again in one process, under limits.

Usage: ``driver.py GOOD_SURVEY OUT BYTES``. The good survey is mapped first, so that compiled kernels and libraries are
loaded before memory is limited to BYTES; then "ready" is written. Then each line on standard input is a JSON list of
arguments, each line on standard output the JSON record of what became of it. Descriptors 1 and 2 are watched
themselves: a panic in Rust writes to them past ``sys.stderr``.
"""

import contextlib
import json
import os
import resource
import sys
import tempfile
import threading
import traceback

from bumpymap.cli import main
from bumpymap.readers.decoder import close_decoder


def run(argv):
    """Give the exit code, or the traceback of what came out instead."""
    try:
        main.main(args=argv, prog_name="bumpymap", standalone_mode=True)
    except SystemExit as end:
        return 0 if end.code is None else end.code
    except BaseException:  # noqa: BLE001 (a Rust panic is no Exception; nothing at all may come out)
        return traceback.format_exc()
    return 0


def size_of(what):
    """Look a size of this process up, in bytes; None where the system does not tell."""
    with contextlib.suppress(OSError), open("/proc/self/status", encoding="ascii") as lines:  # noqa: PTH123
        return next((int(line.split()[1]) * 1024 for line in lines if line.startswith(what + ":")), None)
    return None


def forget_peak():
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w", encoding="ascii") as place:  # noqa: PTH123
        place.write("5")


def limit(budget):
    """Refuse memory beyond the budget: what is reserved counts, touched or not."""
    reserved, resident = size_of("VmSize"), size_of("VmRSS")
    if reserved is not None and resident is not None:
        most = reserved - resident + budget
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def watched(argv, said):
    """Run once; the record of exit, output, memory (with the child that decodes) and threads."""
    os.ftruncate(said, 0)
    os.lseek(said, 0, os.SEEK_SET)
    threads = set(threading.enumerate())
    forget_peak()
    code = run(argv)
    sys.stdout.flush()
    sys.stderr.flush()
    close_decoder()  # the largest child that has ended counts, too; children have the same limit each
    peak = size_of("VmHWM") or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    peak += resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    left = [thread.name for thread in set(threading.enumerate()) - threads]
    text = os.pread(said, os.fstat(said).st_size, 0).decode("utf-8", "replace")
    return {"exit": code, "text": text, "peak": peak, "threads": left}


def serve():
    good, out, budget = sys.argv[1:]
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    with tempfile.TemporaryFile() as file:
        said = file.fileno()
        os.dup2(said, 1)
        os.dup2(said, 2)
        for argv in (["map", good, "--out", out, "--local", "--threads", "1", "--overwrite"], ["info", good]):
            first = watched(argv, said)
            if first["exit"] != 0:
                raise RuntimeError(f"a valid survey cannot be read: {first}")
        limit(int(budget))
        answers.write('"ready"\n')
        answers.flush()
        for line in sys.stdin:
            answers.write(json.dumps(watched(json.loads(line), said)) + "\n")
            answers.flush()


if __name__ == "__main__":
    serve()
