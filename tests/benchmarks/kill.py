"""Kill runs at random times, give the same command again, and compare every file with that of an uninterrupted run.

python tests/benchmarks/kill.py SURVEY... --data FOLDER [--kills 20] [--seed 1] [--map-options "--memory 256MB"]

SIGKILL cannot be caught: the next run finds the files on disk as they were at that time. Times are drawn uniformly over
the duration of a whole run; some of the resumed runs are killed once more. The exit code is 1 if any file differs or
anything is left behind.
"""

import argparse
import hashlib
import json
import random
import shlex
import shutil
import statistics
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

FIGURES = Path(__file__).resolve().parents[2] / "docs" / "figures" / "kills.md"
_WHOLE_RUNS = 3
_KILLED_TWICE = 0.3
"""Share of the runs that are killed once more, in the second run."""
_WORK, _STAGED = ".bumpymap-run", ".bumpymap-layers-*"
_OF_THE_CALL = ("out", "scratch", "resume", "overwrite")
"""Settings in run.json that depend on how a run was called and may differ."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One run that was killed, and its outcome after resuming."""

    instant: float
    """Time of the first kill, s after the start."""
    stages: list[str]
    """What the run was doing at each kill."""
    resumed: float
    """Duration of the last resumed run, s."""
    faults: list[str]
    """Empty if every file is the same and nothing is left behind."""


class KillTest:
    """The command under test, its folders, and the files of an uninterrupted run."""

    def __init__(self, surveys: list[Path], data: Path, options: list[str]) -> None:
        self._out, self._scratch = data / "layers", data / "scratch"
        bumpymap = str(Path(sys.executable).with_name("bumpymap"))
        self._command = [bumpymap, "map", *map(str, surveys), "--out", str(self._out)]
        self._command += ["--set", f"scratch={self._scratch}", "--quiet", *options]
        self._expected: dict[str, str] = {}
        self._orphans: list[Path] = []

    def whole(self) -> float:
        """Run without a kill and store the checksums of the files; return the duration, s."""
        self._clear()
        seconds = self._finish()
        found = self._files()
        if self._expected and found != self._expected:
            sys.exit(f"two uninterrupted runs differ: {_differences(self._expected, found)}")
        self._expected = found
        return seconds

    def trial(self, instant: float, again: float | None) -> Trial | None:
        """Kill a run, and optionally the resumed run; return None if the run ended before the kill."""
        self._clear()
        stages = [self._killed(instant)]
        if not stages[0]:
            return None
        resumed = 0.0
        if again is not None:
            begin = time.perf_counter()
            if stage := self._killed(again):
                stages.append(stage)
            else:
                resumed = time.perf_counter() - begin
        # A run that has ended cannot be resumed; its layers are compared as they are.
        if not (self._out / "run.json").exists() or (self._out / _WORK).exists():
            resumed = self._finish()
        faults = _differences(self._expected, self._files())
        faults += [f"{left.name} is left in the scratch folder" for left in self._scratch.glob("*")]
        faults += [f"process {helper.name} still runs" for helper in self._orphans if helper.exists()]
        return Trial(instant, stages, resumed, faults)

    def _clear(self) -> None:
        self._orphans.clear()
        for folder in (self._out, self._scratch):
            shutil.rmtree(folder, ignore_errors=True)
        self._scratch.mkdir(parents=True)

    def _finish(self, *more: str) -> float:
        begin = time.perf_counter()
        done = subprocess.run([*self._command, *more], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            sys.exit(f"{shlex.join([*self._command, *more])} failed with exit code {done.returncode}:\n{done.stderr}")
        return time.perf_counter() - begin

    def _killed(self, instant: float, *more: str) -> str:
        """Run and kill after ``instant`` seconds; return the stage, or an empty string if the run had ended."""
        process = subprocess.Popen([*self._command, *more], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            process.wait(instant)
        except subprocess.TimeoutExpired:
            helpers = _children(process.pid)
            process.kill()
            process.wait()
            self._orphans += helpers
            return self._stage()
        return ""

    def _stage(self) -> str:
        """Describe the stage of a killed run by the files on disk."""
        work = self._out / _WORK
        staged = [path for folder in self._out.glob(_STAGED) for path in folder.rglob("*") if path.is_file()]
        points, tiles = (
            len(list(folder.glob(pack)))
            for folder, pack in ((self._scratch, "**/points-*.pack"), (work, "tiles-*.pack"))
        )
        packs = f"packs on disk: {points} of points, {tiles} of tiles"
        if (self._out / "run.json").exists():
            return "at the end, layers in place"
        if staged:
            return f"writing layers, {len(staged)} begun"
        if (work / "read.json").exists():
            return "between measuring and writing"
        if any("early" not in pack.name for pack in work.glob("tiles-*.pack")):
            return f"measuring, {packs}"
        if points or tiles:
            return f"reading or measuring, {packs}"
        return "reading or measuring, nothing on disk" if (work / "run_spec.json").exists() else "starting"

    def _files(self) -> dict[str, str]:
        """Return the checksum of each file in --out, by name; times and call settings of run.json are ignored."""
        found = {}
        for path in sorted(self._out.rglob("*")):
            content = path.read_bytes() if path.is_file() else b""
            if path.name == "run.json":
                run: dict[str, Any] = json.loads(content)
                run.pop("seconds")
                settings = {name: value for name, value in run["settings"].items() if name not in _OF_THE_CALL}
                content = json.dumps(run | {"settings": settings}).encode()
            found[str(path.relative_to(self._out))] = hashlib.sha256(content).hexdigest()
        return found


def _children(pid: int) -> list[Path]:
    """List the processes that a process has started, by their folders in /proc."""
    lists = Path(f"/proc/{pid}/task").glob("*/children")
    return [Path("/proc", child) for text in lists for child in text.read_text(encoding="utf-8").split()]


def _differences(wanted: dict[str, str], found: dict[str, str]) -> list[str]:
    names = sorted({*wanted, *found})
    fault = {True: "{} is missing", False: "{} differs"}
    return [
        f"{name} is left in --out" if name not in wanted else fault[name not in found].format(name)
        for name in names
        if wanted.get(name) != found.get(name)
    ]


def run(kill_test: KillTest, kills: int, seed: int) -> tuple[float, list[Trial]]:
    """Run the trials; return the duration of a whole run, s, and the trials."""
    whole = statistics.median(kill_test.whole() for _ in range(_WHOLE_RUNS))
    sys.stderr.write(f"a whole run takes {whole:.2f} s\n")
    draw = random.Random(seed)
    trials: list[Trial] = []
    while len(trials) < kills:
        instant, twice, again = draw.uniform(0, whole), draw.random() < _KILLED_TWICE, draw.uniform(0, whole)
        trial = kill_test.trial(instant, again if twice else None)
        if trial is None:
            continue
        trials.append(trial)
        verdict = "; ".join(trial.faults) or "same"
        sys.stderr.write(f"{len(trials):3} {instant:7.2f} s  {'; then '.join(trial.stages)}: {verdict}\n")
    return whole, trials


def summary(kept: dict[str, Any]) -> str:
    """Return a Markdown table of all tested surveys, one row each."""
    lines = [
        (
            "| survey | killed while starting / reading or measuring / writing layers / done | killed twice "
            "| identical | uninterrupted [s] |"
        ),
        "|---|---|---|---|---|",
    ]
    for title, survey in kept.items():
        trials = [Trial(**trial) for trial in survey["trials"]]
        first = [trial.stages[0] for trial in trials]
        stages = ("starting", ("reading", "measuring", "between"), "writing", "at the end")
        counts = " / ".join(str(sum(stage.startswith(begin) for stage in first)) for begin in stages)
        twice = sum(len(trial.stages) > 1 for trial in trials)
        same = sum(not trial.faults for trial in trials)
        lines.append(f"| {title} | {counts} | {twice} | {same} of {len(trials)} | {survey['whole_s']:.1f} |")
    return "\n".join(lines)


def main() -> None:
    """Run the trials of one survey; print tables of all surveys tested with this --data."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("surveys", type=Path, nargs="+", metavar="SURVEY")
    parser.add_argument("--data", type=Path, required=True, help="folder for layers, scratch and results")
    parser.add_argument("--title", default="survey", help="name of the survey in the table")
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--map-options", default="", metavar="TEXT", help="more options for bumpymap map")
    parser.add_argument("--page", action="store_true", help="write the summary into docs/figures")
    given = parser.parse_args()
    whole, trials = run(KillTest(given.surveys, given.data, shlex.split(given.map_options)), given.kills, given.seed)
    results = given.data / "kills.json"
    kept = json.loads(results.read_text(encoding="utf-8")) if results.exists() else {}
    kept[given.title] = {"whole_s": whole, "trials": [asdict(trial) for trial in trials]}
    results.write_text(json.dumps(kept, indent=1), encoding="utf-8")
    text = summary(kept)
    print(text)
    if given.page:
        FIGURES.write_text(text + "\n", encoding="utf-8")
    if any(trial.faults for trial in trials):
        sys.exit(1)


if __name__ == "__main__":
    main()
