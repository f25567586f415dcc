"""Child process of the hostile corpus: runs the command line again and again in one process, under limits.

Usage: ``driver.py GOOD_SURVEY OUT BYTES``. The good survey is mapped first, so that libraries are loaded
before memory is limited to BYTES. Then each line on standard input is a JSON list of arguments, each line on
standard output the JSON record of what became of it.
"""

import contextlib
import json
import os
import resource
import sys
import threading
import traceback

from bumpymap.cli import main
from bumpymap.readers.decoder import close_decoder

SAID = 2
"""The file to which descriptors 1 and 2 write, themselves: a panic in Rust writes to them past ``sys.stderr``."""


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


def watched(argv):
    """Run once; the record of exit, output, memory (with the child that decodes) and threads."""
    threads = set(threading.enumerate())
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w", encoding="ascii") as place:  # noqa: PTH123
        place.write("5")  # forgets the peak
    code = run(argv)
    sys.stdout.flush()
    sys.stderr.flush()
    close_decoder()  # the largest child that has ended counts, too; children have the same limit each
    peak = size_of("VmHWM") or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    peak += resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    left = [thread.name for thread in set(threading.enumerate()) - threads]
    return {"exit": code, "text": text_said(), "peak": peak, "threads": left}


def text_said():
    """What was written since the last question."""
    return os.pread(SAID, os.fstat(SAID).st_size, 0).decode("utf-8", "replace")


def serve(warm, answer, budget):
    """Run ``warm``, refuse memory beyond the budget [bytes], write "ready", and answer each line with one of JSON."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(SAID, 1)
    warm()
    reserved, resident = size_of("VmSize"), size_of("VmRSS")
    if reserved is not None and resident is not None:
        most = reserved - resident + budget  # what is reserved counts, touched or not
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    answers.write('"ready"\n')
    answers.flush()
    for line in sys.stdin:
        os.ftruncate(SAID, 0)
        os.lseek(SAID, 0, os.SEEK_SET)
        answers.write(json.dumps(answer(json.loads(line))) + "\n")
        answers.flush()


def warm():
    """Map the good survey."""
    good, out, _ = sys.argv[1:]
    for argv in (["map", good, "--out", out, "--local", "--threads", "1", "--overwrite"], ["info", good]):
        if run(argv) != 0:
            raise RuntimeError("a valid survey cannot be read")


if __name__ == "__main__":
    serve(warm, watched, int(sys.argv[3]))
