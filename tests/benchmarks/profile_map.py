"""Show where a run of ``bumpymap map`` spends its time, and what it reads.

python tests/benchmarks/profile_map.py SURVEY --data FOLDER [--crs EPSG:CODE] [--command PATH/bumpymap --label before]

The survey is mapped once under strace, which counts the bytes of each file, then in rounds: a timed run, and a run that
perf samples 499 times per second and core. Without strace or perf, their tables are left out, and it says so. The
figures are kept in FOLDER/profile.json under the title of the survey and the label of the command, so that two commands
stand side by side; --page inserts all tables into the documentation. Options that are not listed here, such as --crs or
--memory, are those of ``bumpymap map``.

Waiting is time in which a core did not work for the command, so other programs on the machine add to it.
"""

import argparse
import json
import os
import statistics
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

from _file_bytes import FileBytes, count_file_bytes
from _measure import files_of, run_timed, warm_page_cache
from _page import insert_tables, machine
from _profile_page import profile_tables
from _samples import sample

HERE = Path(__file__).resolve().parent
PAGE = HERE.parents[1] / "docs" / "pages" / "benchmarks.md"


def profile(command: list[str], survey: Path, out: Path, rounds: int) -> dict[str, Any]:
    """Return the figures of a command: medians of the timed runs, and samples of all sampled runs."""
    sys.stderr.write("counting bytes\n")
    files = count_file_bytes(command)  # and compiles what is not compiled yet
    samples: Counter[str] | None = Counter()
    peak = run_timed(command, memory=True).peak
    timed, stages = [], []
    for number in range(rounds):
        sys.stderr.write(f"round {number + 1} of {rounds}\n")
        warm_page_cache(survey)
        run = run_timed(command)
        if run.exit_code != 0:
            sys.exit(f"{' '.join(command)} failed:\n{run.stderr_tail}")
        timed.append(replace(run, peak=peak).record())
        stages.append(json.loads((out / "run.json").read_text(encoding="utf-8"))["seconds"])
        if samples is not None:
            once = sample(command)
            samples = None if once is None else samples + once
    return {
        "rounds": rounds,
        "survey_bytes": sum(path.stat().st_size for path in files_of(survey)),
        "timed": {key: statistics.median(each[key] for each in timed) for key in timed[0]},
        "stages": {name: statistics.median(each.get(name, 0.0) for each in stages) for name in stages[0]},
        "samples": None if samples is None else dict(samples.most_common()),
        "files": None if files is None else _by_role(files, survey, out),
    }


def _by_role(files: dict[str, FileBytes], survey: Path, out: Path) -> dict[str, list[int]]:
    """Sum up bytes read, mapped and written by what the files are for."""
    surveys = {str(path.resolve()) for path in files_of(survey)}
    sums: dict[str, list[int]] = {"the survey": [0, 0, 0]}
    for path, each in files.items():
        total = sums.setdefault("the survey" if path in surveys else _role(Path(path), out.resolve()), [0, 0, 0])
        for at, value in enumerate((each.read, each.mapped, each.written)):
            total[at] += value
    return sums


def _role(path: Path, out: Path) -> str:
    """Return what a file other than the survey is for."""
    if not path.is_relative_to(out):
        return "programs, libraries, their data"
    inside = path.relative_to(out).parts
    if inside[0] == ".bumpymap-run":
        return "points on disk" if "points" in inside[1:-1] else "checkpoints and finished tiles"
    return "layers"


def main() -> None:
    """Profile one command on one survey, keep the figures and print all tables so far."""
    given, options = _arguments()
    given.data.mkdir(parents=True, exist_ok=True)
    kept = given.data / "profile.json"
    results: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else {}
    if given.survey is not None:
        out = given.data / "out" / f"profile_{given.label}"
        out.parent.mkdir(parents=True, exist_ok=True)
        command = [given.command, "map", str(given.survey), "--out", str(out), "--overwrite", "--quiet", *options]
        figures = profile(command, given.survey, out, given.rounds)
        figures["machine"] = machine()
        results.setdefault(given.title or given.survey.name, {})[given.label] = figures
        kept.write_text(json.dumps(results, indent=1), encoding="utf-8")
    text = profile_tables(results, len(os.sched_getaffinity(0)))
    print(text)
    if given.page:
        insert_tables(given.page, text, "profile")


def _arguments() -> tuple[argparse.Namespace, list[str]]:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    add = parser.add_argument
    add("survey", type=Path, nargs="?", metavar="SURVEY", help="file or folder; without it, print the tables so far")
    add("--data", type=Path, default=HERE / "data", help="folder of layers and raw figures")
    add("--command", default=str(Path(sys.executable).with_name("bumpymap")), help="the bumpymap to run")
    add("--label", default="now", help="what the figures of this command are called")
    add("--title", help="what the survey is called [its file name]")
    add("--rounds", type=int, default=3)
    add("--page", type=Path, help=f"insert the tables into this page, as {PAGE.name}")
    given, options = parser.parse_known_args()
    if given.rounds < 1:
        parser.error(f"--rounds is {given.rounds}; it must be at least 1")
    if given.survey is not None and not given.survey.exists():
        parser.error(f"there is no {given.survey}")
    if options and given.survey is None:
        parser.error(f"{options[0]} needs a SURVEY before it")
    return given, options


if __name__ == "__main__":
    main()
