"""The cases of the benchmarks: surveys, and the commands that are timed on each of them in turn."""

import argparse
import json
import shlex
import shutil
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from _measure import run_timed

__all__ = ["EXTRA", "MADE", "ONCE", "Bench", "Case", "answer", "prepare"]

HERE = Path(__file__).resolve().parent
SAMPLE = HERE.parents[1] / "sample_data" / "quarry.laz"
_MILLION = 1_000_000


@dataclass(frozen=True, slots=True)
class _Made:
    """A synthetic survey, and what is run on it."""

    millions: int
    order: str
    format: str
    cuts: int = 1
    sides: tuple[str, ...] = ("map",)


_ALL = ("read", "map", "before", "pdal", "pdal_bin")
MADE = {
    "10m-laz": _Made(10, "sorted", "laz"),
    "20m-laz": _Made(20, "sorted", "laz", sides=(*_ALL, "map_1gb")),
    "20m-las": _Made(20, "sorted", "las", sides=(*_ALL, "map_1gb", "before_1gb")),
    "20m-shuffled": _Made(20, "shuffled", "laz", sides=("map_1gb",)),
    "16x2.5m-laz": _Made(40, "sorted", "laz", cuts=4, sides=("map", "before")),
    "200m-laz": _Made(200, "sorted", "laz", sides=("map_1gb",)),
    "200m-shuffled": _Made(200, "shuffled", "laz", sides=("map_1gb",)),
    "100m-laz": _Made(100, "sorted", "laz"),
    "100m-copc": _Made(100, "sorted", "copc"),
    "1000m-laz": _Made(1000, "sorted", "laz"),
    "1000m-copc": _Made(1000, "sorted", "copc"),
}
EXTRA = ("100m-laz", "100m-copc", "1000m-laz", "1000m-copc")
"""Cases that run only if they are named."""
ONCE = tuple(key for key, made in MADE.items() if made.millions >= 200)
"""Cases that run in the first round only."""
_OPTIONS = {"map": [], "map_1gb": ["--memory", "1GB"]}
"""Side -> options; sides that begin with ``before`` have the same ones."""
_STATISTICS = "mean,stdev,min,max,count"


@dataclass(frozen=True, slots=True)
class Case:
    """Commands that are timed alternately on one survey."""

    key: str
    survey: Path
    sides: dict[str, list[str]]


class Bench:
    """The settings of a call and the commands to time."""

    def __init__(self, given: argparse.Namespace) -> None:
        self.data: Path = given.data
        self.options: list[str] = shlex.split(given.map_options)
        self.command = str(Path(sys.executable).with_name("bumpymap"))
        self.before: str | None = given.before
        self.pdal = shutil.which("pdal")

    def out(self, key: str, side: str = "map") -> Path:
        """Return the folder for the layers of a case."""
        return self.data / "out" / (key if side == "map" else f"{key}_{side}")

    def map(self, survey: Path, key: str, side: str = "map", more: Iterable[str] = ()) -> list[str]:
        """Return the command that maps a survey; sides that begin with ``before`` are those of the other version."""
        command = self.before if side.startswith("before") else self.command
        options = _OPTIONS.get(side.replace("before", "map"), [])
        out = str(self.out(key, side))
        words = [str(command), "map", str(survey), "--out", out, "--overwrite", "--quiet"]
        return [*words, *options, *more, *self.options]

    def case(self, key: str, survey: Path, sides: Iterable[str], more: Iterable[str] = ()) -> Case:
        """Return a case with those of the sides that can run here."""
        commands = {}
        for side in sides:
            if side == "read":
                commands[side] = [sys.executable, str(HERE / "read_all.py"), str(survey)]
            elif side.startswith("pdal"):
                if self.pdal:
                    commands[side] = self._grid(survey, f"{key}_{side}", binmode=side == "pdal_bin")
            elif self.before or not side.startswith("before"):
                commands[side] = self.map(survey, key, side, more)
        return Case(key, survey, commands)

    def _grid(self, survey: Path, name: str, *, binmode: bool) -> list[str]:
        """Return the command that makes a 3 m raster with PDAL, in streaming mode."""
        pipeline = self.data / "out" / f"{name}.json"
        pipeline.parent.mkdir(parents=True, exist_ok=True)
        writer = {"type": "writers.gdal", "filename": str(pipeline.with_suffix(".tif")), "resolution": 3.0}
        more = {"binmode": True} if binmode else {}
        stages = [{"type": "readers.las", "filename": str(survey)}, {**writer, **more, "output_type": _STATISTICS}]
        pipeline.write_text(json.dumps(stages), encoding="utf-8")
        return [str(self.pdal), "pipeline", str(pipeline)]

    def start(self) -> Case:
        """Return the case for startup time: help, and a first run without compiled kernels."""
        run = self.map(SAMPLE, "start")
        return Case("start", SAMPLE, {"first run": run, "second run": run, "--help": [self.command, "--help"]})

    def warm_up(self) -> None:
        """Map the sample once with each version, so that kernels and bytecode are compiled before anything is timed."""
        for command in self.case("warm-up", SAMPLE, ("map", "before")).sides.values():
            sample = run_timed(command)
            if sample.exit_code != 0:
                sys.exit(f"{' '.join(command)} failed:\n{sample.stderr_tail}")


def answer(command: list[str], env: dict[str, str] | None = None) -> dict[str, Any]:
    """Return the JSON that a script prints; end if it fails."""
    done = run_timed(command, env)
    if done.exit_code != 0:
        sys.exit(f"{' '.join(command)} failed:\n{done.stderr_tail}")
    value: dict[str, Any] = json.loads(done.output)
    return value


def _make(data: Path, made: _Made, scale: float) -> dict[str, Any]:
    """Make a survey in a separate process; return its facts."""
    points = str(max(1, round(made.millions * _MILLION * scale)))
    script = [sys.executable, str(HERE / "surveys.py"), "--data", str(data), "--points", points]
    return answer([*script, "--order", made.order, "--format", made.format, "--cuts", str(made.cuts)])


def _title(made: _Made, scale: float) -> str:
    millions = made.millions * scale
    if made.cuts > 1:
        return f"{made.cuts**2} adjoining files of {millions / made.cuts**2:g} million points, {made.format.upper()}"
    order = "" if made.format == "copc" else f" {made.order},"
    return f"{millions:,g} million points,{order} {made.format.upper()}"


def prepare(given: argparse.Namespace, bench: Bench, wanted: list[str], results: dict[str, Any]) -> list[Case]:
    """Make the surveys and list the selected cases."""
    cases = []
    for number, survey in enumerate(given.survey, start=1):
        key = f"real{number}"
        if key in wanted:
            crs = ["--crs", given.crs[number - 1]] if number <= len(given.crs) and given.crs[number - 1] else []
            fact = answer([sys.executable, str(HERE / "surveys.py"), "--facts", str(survey)])
            results["surveys"][key] = fact
            results["titles"][key] = "real drone survey" + (f" {number}" if len(given.survey) > 1 else "")
            cases.append(bench.case(key, survey, _ALL, crs))
    for key, made in MADE.items():
        if key in wanted:
            fact = results["surveys"][key] = _make(given.data, made, given.scale)
            results["titles"][key] = _title(made, given.scale)
            cases.append(bench.case(key, Path(fact["path"]), made.sides))
    if "sample" in wanted:
        fact = answer([sys.executable, str(HERE / "surveys.py"), "--facts", str(SAMPLE)])
        results["surveys"]["sample"], results["titles"]["sample"] = fact, "sample survey"
        cases.append(bench.case("sample", SAMPLE, ("map", "before")))
    if "start" in wanted:
        results["titles"]["start"] = "start"
        cases.append(bench.start())
    for fact in results["surveys"].values():
        fact.pop("path", None)
    return cases
