"""Compare the time of bumpymap with reading only, with PDAL and with another bumpymap.

python tests/benchmarks/run.py --data FOLDER [--survey FILE --crs EPSG:CODE] [--before PATH/bumpymap] [--rounds 5]

Whole commands are timed alternately, round by round: reading, mapping, PDAL. The first run makes the surveys (1 GB on
disk). A complete run writes its table into the documentation; --only runs some cases. That of 1,000 million points runs
only if it is named, and once.

Linux includes the memory of the parent process in the peak of a new process, so nothing heavy may be imported here.
"""

import argparse
import importlib.metadata
import json
import os
import platform
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import psutil

HERE = Path(__file__).resolve().parent
FIGURES = HERE.parents[1] / "docs" / "figures" / "speed.md"
SAMPLE = HERE.parents[1] / "sample_data" / "quarry.laz"
BUMPYMAP = str(Path(sys.executable).with_name("bumpymap"))
READ_ALL = """
import sys, laspy
with laspy.open(sys.argv[1], laz_backend=laspy.LazBackend.LazrsParallel) as reader:
    for _ in reader.chunk_iterator(1_000_000):
        pass
"""
"""Decodes every field of every point and discards it: the lower bound for the time of ``map``."""
SIDES = {
    "read": "laspy + lazrs, every field",
    "map": "`bumpymap map`",
    "map_1gb": "`bumpymap map --memory 1GB`",
    "before": "`bumpymap map`, before",
    "pdal": "PDAL `writers.gdal`",
    "pdal_bin": "PDAL `writers.gdal`, `binmode`",
}
"""What is timed on a survey; ``before`` is the other version."""
ALL = ("read", "map", "before", "pdal", "pdal_bin")
MADE = {
    "20m-laz": (20, "laz", (*ALL, "map_1gb")),
    "20m-las": (20, "las", (*ALL, "map_1gb")),
    "1000m-laz": (1000, "laz", ("map",)),
}
"""Synthetic surveys: million points, format, and what is timed on them."""
LARGE = {"1000m-laz"}
"""Cases that run only if they are named, and only once."""
PACKAGES = ("bumpymap", "laspy", "lazrs", "numpy", "onnxruntime", "rasterio", "open3d", "scikit-learn")
_NOT_OF_A_USER = ("PYTHONDONTWRITEBYTECODE", "PYTHONUNBUFFERED")
"""Settings of Python that make it slower."""
_POLL_SECONDS = 0.05


@dataclass(frozen=True, slots=True)
class Sample:
    """Measurements of one run of one command, with its child processes."""

    wall: float
    """s."""
    cpu: float
    """Processor time, user and system, s."""
    peak: float
    """Peak memory of the command and its child processes, with shared memory counted once, bytes; sampled."""
    exit_code: int
    stderr_tail: str
    """End of its standard error."""


def run_timed(command: Sequence[str], *, memory: bool = False) -> Sample:
    """Run a command to its end, in the environment of a user.

    With ``memory`` its memory is sampled, child processes included, which slows it down: large processes most, as the
    kernel walks all their pages. Without, ``peak`` is that of the largest process.
    """
    os.sync()  # so that writes of an earlier command do not slow this one down
    own = {name: value for name, value in os.environ.items() if name not in _NOT_OF_A_USER}
    peak, ended = [0.0], threading.Event()
    with tempfile.TemporaryFile() as err:
        started = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=err, stdin=subprocess.DEVNULL, env=own)
        sampling = threading.Thread(target=_sample, args=(psutil.Process(process.pid), peak, ended), daemon=True)
        if memory:
            sampling.start()
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # its figures remain until it is waited for
        wall = time.perf_counter() - started
        ended.set()
        if memory:
            sampling.join()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        err.seek(0)
        tail = err.read().decode(errors="replace")[-800:]
    cpu, largest = usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024.0
    return Sample(wall, cpu, max(peak[0], largest), process.returncode, tail)


def _sample(parent, peak, ended):
    """Keep the peak of the sum of PSS of a process and its descendants [bytes] in ``peak[0]`` until ``ended`` is set.

    PSS (proportional set size) divides shared pages among the processes that map them. Reading it is slow, as the
    kernel walks all pages, so it is read only if the sum of resident sizes, which is never smaller, exceeds the peak.
    """
    while not ended.wait(_POLL_SECONDS):
        with suppress(psutil.Error):  # one of them has ended
            tree = [parent, *parent.children(recursive=True)]
            if sum(process.memory_info().rss for process in tree) > peak[0]:
                peak[0] = max(peak[0], sum(process.memory_full_info().pss for process in tree))


def command_of(given, key, side, survey):
    """Return the command of a program on the survey of a case; None if it cannot run here."""
    out = given.data / "out" / f"{key}_{side}"
    if side == "--help":
        return [BUMPYMAP, side]
    if side == "read":
        return [sys.executable, "-c", READ_ALL, str(survey)]
    if side.startswith("pdal"):
        if shutil.which("pdal") is None:
            return None
        out.parent.mkdir(parents=True, exist_ok=True)
        writer = {"type": "writers.gdal", "filename": str(out.with_suffix(".tif")), "resolution": 3.0}
        writer |= {"output_type": "mean,stdev,min,max,count"} | ({"binmode": True} if side == "pdal_bin" else {})
        stages = [{"type": "readers.las", "filename": str(survey)}, writer]
        out.with_suffix(".json").write_text(json.dumps(stages), encoding="utf-8")
        return ["pdal", "pipeline", str(out.with_suffix(".json"))]
    command = given.before if side.startswith("before") else BUMPYMAP
    more = ["--memory", "1GB"] if side.endswith("_1gb") else []
    more += ["--crs", given.crs] if key == "real" and given.crs else []
    return command and [command, "map", str(survey), "--out", str(out), "--overwrite", "--quiet", *more]


def prepare(given, wanted):
    """Make the surveys; return title, path and commands of each wanted case."""
    fixed = {
        "real": ("real drone survey", given.survey, ALL),
        "sample": ("sample survey", SAMPLE, ("map", "before")),
        "start": ("start", SAMPLE, ("--help",)),
    }
    cases = {}
    for key in wanted:
        if key in MADE:
            millions, suffix, sides = MADE[key]
            title = f"{millions * given.scale:g} million points, {suffix.upper()}"
            points = max(1, round(millions * 1_000_000 * given.scale))
            words = ("--data", given.data, "--points", points, "--format", suffix)
            make = [sys.executable, HERE / "surveys.py", *words]
            survey = Path(subprocess.run([*map(str, make)], check=True, capture_output=True, text=True).stdout.strip())
        else:
            title, survey, sides = fixed[key]
        commands = {side: command_of(given, key, side, survey) for side in sides}
        cases[key] = title, survey, {side: command for side, command in commands.items() if command}
    return cases


def measure(given, cases):
    """Run the rounds of the cases; return the samples by case and program."""
    for side in ("map", "before"):
        if command := command_of(given, "warm-up", side, SAMPLE):
            run_timed(command)  # compiles bytecode before anything is timed
    samples = {key: {side: [] for side in commands} for key, (_, _, commands) in cases.items()}
    peaks = {}
    for number in range(given.rounds):
        for key, (_, survey, commands) in cases.items():
            if number and key in LARGE:
                continue
            for path in sorted(survey.iterdir()) if survey.is_dir() else [survey]:
                subprocess.run(["cat", path], stdout=subprocess.DEVNULL, check=True)  # into the page cache
            for side, command in commands.items():
                once = key == "start" or key in LARGE
                if not once and (key, side) not in peaks:
                    peaks[key, side] = run_timed(command, memory=True).peak
                sample = run_timed(command, memory=once)
                sample = replace(sample, peak=peaks.get((key, side), sample.peak))
                sys.stderr.write(f"{number + 1} {key:14} {side:14} {sample}\n")
                samples[key][side].append(sample)
    return samples


def machine():
    """Describe this machine (without its name) and the versions in use."""
    there = {found.name for found in importlib.metadata.distributions()}
    versions = [f"{name} {importlib.metadata.version(name)}" for name in PACKAGES if name in there]
    if shutil.which("pdal"):
        shown = subprocess.run(["pdal", "--version"], capture_output=True, text=True, check=False).stdout
        versions += re.findall(r"pdal \d[\d.]*", shown)
    processor = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text(encoding="utf-8"))
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    return (
        f"{processor[1] if processor else platform.machine()}, {len(os.sched_getaffinity(0))} cores, {memory:.1f} GB, "
        f"{platform.system()} {platform.release().split('-')[0]}. python {platform.python_version()}, "
        f"{', '.join(versions)}. Medians of the runs of each program."
    )


def table(cases, samples):
    """Return the table of all programs as Markdown."""
    rows = [("case", "program", "wall time [s]", "processor time [s]", "peak memory [GB]"), ("---",) * 5]
    for key, sides in samples.items():
        for side, found in sides.items():
            wall, cpu, peak = (statistics.median(getattr(one, of) for one in found) for of in ("wall", "cpu", "peak"))
            figures = (f"{wall:.2f}", f"{cpu:.2f}", f"{peak / 1e9:.2f}")
            failed = any(one.exit_code for one in found)
            name = SIDES.get(side, f"`bumpymap`, {side}")
            rows.append((cases[key][0], name, *(("failed", "", "") if failed else figures)))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def main():
    """Measure and print the tables; write them into the documentation after a complete run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of surveys, layers and raw figures")
    parser.add_argument("--survey", type=Path, help="a real survey in metres")
    parser.add_argument("--crs", help="its CRS if it has none")
    parser.add_argument("--before", metavar="COMMAND", help="another bumpymap to compare with, as PATH/bumpymap")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", default="", metavar="CASE,...", help="some cases: real, 20m-laz, 1000m-laz, start")
    parser.add_argument("--scale", type=float, default=1.0, help="share of the points, such as 0.01 for a quick test")
    given = parser.parse_args()
    possible = [*(["real"] if given.survey else []), *MADE, "sample", "start"]
    wanted = given.only.split(",") if given.only else [key for key in possible if key not in LARGE]
    if unknown := sorted(set(wanted) - set(possible)):
        parser.error(f"--only names {', '.join(unknown)}; there are: {', '.join(possible)}")
    given.data.mkdir(parents=True, exist_ok=True)
    cases = prepare(given, wanted)
    figures = f"{machine()}\n\n{table(cases, measure(given, cases))}\n"
    print(figures)
    if given.scale == 1.0 and not given.only:
        FIGURES.write_text(figures, encoding="utf-8")


if __name__ == "__main__":
    main()
