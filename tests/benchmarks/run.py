"""Compare the time of bumpymap with reading only, with PDAL and with another bumpymap.

python tests/benchmarks/run.py --data FOLDER [--survey FILE --crs EPSG:CODE] [--before PATH/bumpymap] [--rounds 5]

Whole commands are timed alternately, round by round: reading, mapping, PDAL. The first run makes the surveys (6 GB on
disk). The raw figures are written to FOLDER/results.json; a complete run inserts the tables into the documentation.
The cases can be run in parts (--only); figures of other cases in results.json are kept. Cases of 100 and 1,000 million
points run only if they are named; those of 200 million and more run once, whatever --rounds is.
"""

import argparse
import importlib.metadata
import json
import os
import platform
import re
import shlex
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from _measure import run_timed, table, warm_page_cache

HERE = Path(__file__).resolve().parent
FIGURES = HERE.parents[1] / "docs" / "figures" / "speed.md"
SAMPLE = HERE.parents[1] / "sample_data" / "quarry.laz"
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
    "before_1gb": "`bumpymap map --memory 1GB`, before",
    "pdal": "PDAL `writers.gdal`",
    "pdal_bin": "PDAL `writers.gdal`, `binmode`",
}
"""What is timed on a survey; ``before`` is the other version."""
_ALL = ("read", "map", "before", "pdal", "pdal_bin")
_PACKAGES = ("bumpymap", "laspy", "lazrs", "numpy", "numba", "onnxruntime", "rasterio", "open3d", "scikit-learn")


@dataclass(frozen=True, slots=True)
class MadeSurvey:
    """A synthetic survey, and what is run on it."""

    millions: int
    order: str
    format: str
    sides: tuple[str, ...] = ("map",)

    def title(self, scale: float) -> str:
        """Name the survey in the tables."""
        return f"{self.millions * scale:g} million points, {self.order}, {self.format.upper()}"


MADE = {
    "10m-laz": MadeSurvey(10, "sorted", "laz"),
    "20m-laz": MadeSurvey(20, "sorted", "laz", sides=(*_ALL, "map_1gb")),
    "20m-las": MadeSurvey(20, "sorted", "las", sides=(*_ALL, "map_1gb", "before_1gb")),
    "20m-shuffled": MadeSurvey(20, "shuffled", "laz", sides=("map_1gb",)),
    "200m-laz": MadeSurvey(200, "sorted", "laz", sides=("map_1gb",)),
    "200m-shuffled": MadeSurvey(200, "shuffled", "laz", sides=("map_1gb",)),
    "100m-laz": MadeSurvey(100, "sorted", "laz"),
    "1000m-laz": MadeSurvey(1000, "sorted", "laz"),
}
EXTRA = ("100m-laz", "1000m-laz")
"""Cases that run only if they are named."""
ONCE = tuple(key for key, made in MADE.items() if made.millions >= 200)
"""Cases that run in the first round only."""
GOALS = (
    ("real1", "pdal", "map", "wall", "at least", 1.5),
    ("real1", "pdal_bin", "map", "wall", "at least", 1.2),
    ("real1", "map", "read", "wall", "at most", 1.5),
    ("20m-laz", "pdal", "map", "wall", "at least", 1.7),
    ("20m-laz", "pdal_bin", "map", "wall", "at least", 1.4),
    ("20m-laz", "map", "read", "wall", "at most", 1.1),
    ("20m-las", "pdal", "map", "wall", "at least", 3.5),
    ("20m-las", "pdal_bin", "map", "wall", "at least", 2.8),
    ("20m-las", "map", "read", "wall", "at most", 4.0),
    ("20m-las", "map_1gb", "", "peak", "at most", 0.7),
    ("20m-laz", "map_1gb", "", "peak", "at most", 1.3),
    ("20m-shuffled", "map_1gb", "", "peak", "at most", 1.3),
    ("200m-laz", "map_1gb", "", "peak", "at most", 1.3),
    ("200m-shuffled", "map_1gb", "", "peak", "at most", 1.3),
    ("sample", "map", "before", "wall", "at most", 0.7),
    ("start", "--help", "", "wall", "at most", 0.1),
    ("start", "first run", "second run", "added", "at most", 15.0),
)
"""Case, program, program that it is compared with (empty: none), figure, and the target: s, GB, or a ratio."""


class Bench:
    """The settings of a call, and the commands to time."""

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
        """Return the command that maps a survey."""
        command = str(self.before if side.startswith("before") else self.command)
        memory = ["--memory", "1GB"] if side.endswith("_1gb") else []
        words = [command, "map", str(survey), "--out", str(self.out(key, side)), "--overwrite", "--quiet"]
        return [*words, *memory, *more, *self.options]

    def sides(self, key: str, survey: Path, sides: Iterable[str], more: Iterable[str] = ()) -> dict[str, list[str]]:
        """Return the commands of those programs that can run here."""
        commands = {}
        for side in sides:
            if side == "read":
                commands[side] = [sys.executable, "-c", READ_ALL, str(survey)]
            elif side.startswith("pdal"):
                if self.pdal:
                    commands[side] = self._grid(survey, f"{key}_{side}", binmode=side == "pdal_bin")
            elif self.before or not side.startswith("before"):
                commands[side] = self.map(survey, key, side, more)
        return commands

    def _grid(self, survey: Path, name: str, *, binmode: bool) -> list[str]:
        """Return the command that makes a 3 m raster with PDAL, in streaming mode."""
        pipeline = self.data / "out" / f"{name}.json"
        pipeline.parent.mkdir(parents=True, exist_ok=True)
        writer = {"type": "writers.gdal", "filename": str(pipeline.with_suffix(".tif")), "resolution": 3.0}
        writer |= {"output_type": "mean,stdev,min,max,count"} | ({"binmode": True} if binmode else {})
        stages = [{"type": "readers.las", "filename": str(survey)}, writer]
        pipeline.write_text(json.dumps(stages), encoding="utf-8")
        return [str(self.pdal), "pipeline", str(pipeline)]

    def prepare(self, given: argparse.Namespace, wanted: list[str], facts: dict[str, Any]) -> dict[str, dict]:
        """Make the surveys, note their facts, and return the commands of each selected case."""
        cases = {}
        for number, survey in enumerate(given.survey, start=1):
            key = f"real{number}"
            if key in wanted:
                crs = ["--crs", given.crs[number - 1]] if number <= len(given.crs) and given.crs[number - 1] else []
                title = "real drone survey" + (f" {number}" if len(given.survey) > 1 else "")
                facts[key] = {"title": title, **_survey_facts("--facts", survey)}
                cases[key] = self.sides(key, survey, _ALL, crs)
        for key, made in MADE.items():
            if key in wanted:
                points = max(1, round(made.millions * 1_000_000 * given.scale))
                words = ("--data", given.data, "--points", points, "--order", made.order, "--format", made.format)
                facts[key] = {"title": made.title(given.scale), **_survey_facts(*words)}
                cases[key] = self.sides(key, Path(facts[key]["path"]), made.sides)
        if "sample" in wanted:
            facts["sample"] = {"title": "sample survey", **_survey_facts("--facts", SAMPLE)}
            cases["sample"] = self.sides("sample", SAMPLE, ("map", "before"))
        if "start" in wanted:
            run = self.map(SAMPLE, "start")
            facts["start"] = {"title": "start", "path": str(SAMPLE)}
            cases["start"] = {"first run": run, "second run": run, "--help": [self.command, "--help"]}
        return cases


def _survey_facts(*words: object) -> dict[str, Any]:
    """Run ``surveys.py``; return the facts of the survey that it makes or describes."""
    command = [sys.executable, str(HERE / "surveys.py"), *map(str, words)]
    facts: dict[str, Any] = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return facts


def measure(given: argparse.Namespace, wanted: list[str], results: dict[str, Any]) -> None:
    """Run the rounds of the wanted cases; their figures replace earlier ones."""
    bench = Bench(given)
    cases = bench.prepare(given, wanted, results["surveys"])
    for command in bench.sides("warm-up", SAMPLE, ("map", "before")).values():
        run_timed(command)  # compiles kernels and bytecode before anything is timed
    results["samples"] |= {key: {side: [] for side in sides} for key, sides in cases.items()}
    peaks: dict[tuple[str, str], float] = {}
    for number in range(given.rounds):
        for key, sides in cases.items():
            if number and key in ONCE:
                continue
            warm_page_cache(Path(results["surveys"][key]["path"]))
            with tempfile.TemporaryDirectory() as empty:
                env = {"NUMBA_CACHE_DIR": empty} if key == "start" else {}
                for side, command in sides.items():
                    once = bool(env) or key in ONCE
                    if not once and (key, side) not in peaks:
                        peaks[key, side] = run_timed(command, memory=True).peak
                    sample = run_timed(command, env, memory=once)
                    sample = replace(sample, peak=peaks.get((key, side), sample.peak))
                    times = f"{sample.wall:8.2f} s  {sample.user:8.2f} s user  {sample.peak / 1e9:6.2f} GB"
                    sys.stderr.write(f"{number + 1} {key:14} {side:14} {times} {sample.stderr_tail}\n")
                    results["samples"][key][side].append(asdict(replace(sample, output="")))
            (given.data / "results.json").write_text(json.dumps(results, indent=1), encoding="utf-8")
    _compare_layers(bench, results)
    (given.data / "results.json").write_text(json.dumps(results, indent=1), encoding="utf-8")


def _compare_layers(bench: Bench, results: dict[str, Any]) -> None:
    """Note the area of every survey, and whether the layers that must be the same are the same."""
    for key, sides in results["samples"].items():
        sums = {}
        for side in sides:
            manifest = bench.out(key, side) / "run.json"
            if side.startswith(("map", "before")) and manifest.exists():
                run = json.loads(manifest.read_text(encoding="utf-8"))
                results["surveys"][key]["area_m2"] = run["counts"]["tiles"] * run["grid"]["tile_size_m"] ** 2
                sums[side] = {made["path"]: made["sha256"] for made in run["files"]}
        results["same_bits"] |= {f"{key} {side}": own == sums["map"] for side, own in sums.items() if "map" in sums}


def machine() -> dict[str, Any]:
    """Describe this machine (without its name) and the versions in use."""
    versions = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    if pdal := shutil.which("pdal"):
        told = subprocess.run([pdal, "--version"], capture_output=True, text=True, check=False).stdout
        versions["PDAL"] = found[1] if (found := re.search(r"pdal (\d[\d.]*)", told)) else "?"
    processor = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text(encoding="utf-8"))
    return {
        "cores": len(os.sched_getaffinity(0)),
        "processor": processor[1] if processor else platform.machine(),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1),
        "system": f"{platform.system()} {platform.release().split('-')[0]}",
        "versions": versions,
    }


def load(given: argparse.Namespace) -> dict[str, Any]:
    """Return the figures so far if they were measured here, in these versions and at this scale; else none."""
    here = {"machine": machine(), "scale": given.scale}
    path = given.data / "results.json"
    if path.exists():
        old: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if all(old.get(key) == value for key, value in here.items()):
            return old
        kept = path.replace(path.with_name("results-old.json"))
        sys.stderr.write(f"other machine, versions or scale: the figures so far are in {kept}\n")
    return {**here, "surveys": {}, "samples": {}, "same_bits": {}}


def tables(results: dict[str, Any]) -> str:
    """Return the Markdown of all tables: targets, and the figures of every program."""
    facts = results["machine"]
    versions = ", ".join(f"{name} {version}" for name, version in facts["versions"].items())
    text = (
        f"{facts['processor']}, {facts['cores']} cores, {facts['memory_gb']} GB, {facts['system']}. {versions}. "
        "Medians of the runs of each program."
    )
    if results["scale"] != 1.0:
        text += f" A trial with {results['scale']:g} of the points; its times are not representative."
    return "\n\n".join([text, _goal_table(results), _side_table(results)])


def _median(results: dict[str, Any], key: str, side: str, figure: str) -> float | None:
    """Return the median of one program; None if it was not run or failed."""
    samples = results["samples"].get(key, {}).get(side, [])
    if not samples or any(sample["exit_code"] for sample in samples):
        return None
    return float(statistics.median(sample[figure] for sample in samples))


def _goal_table(results: dict[str, Any]) -> str:
    rows = []
    for key, side, other, figure, word, bound in GOALS:
        what = "wall" if figure == "added" else figure
        over, under = _median(results, key, side, what), _median(results, key, other, what) if other else 1.0
        if over is None or under is None:
            continue
        name, unit = f"{results['surveys'][key]['title']}: {SIDES.get(side, side)}", ""
        if figure == "peak":
            label, value, unit = f"{name}, peak memory", over / 1e9, " GB"
        elif figure == "added":
            label, value, unit = f"{name}, time added to the {other}", over - under, " s"
        else:
            label, value = f"{name}, time" + (f" relative to {SIDES[other]}" if other else ""), over / under
            unit = "" if other else " s"
        met = value >= bound if word == "at least" else value <= bound
        rows.append((label, f"{value:.3g}{unit}", f"{word} {bound:g}{unit}", "yes" if met else "no"))
    if results["same_bits"]:
        others = ", ".join(name for name, same in results["same_bits"].items() if not same)
        told, met = (f"other bits: {others}", "no") if others else ("same bits", "yes")
        rows.append(("layers of one survey, with other options and versions", told, "same bits", met))
    return table(("measure", "measured", "target", "met"), rows)


def _side_table(results: dict[str, Any]) -> str:
    rows = []
    for key, sides in results["samples"].items():
        for side, samples in sides.items():
            name = (results["surveys"][key]["title"], SIDES.get(side, f"`bumpymap`, {side}"))
            if codes := [sample["exit_code"] for sample in samples if sample["exit_code"]]:
                rows.append((*name, f"failed (exit {codes[0]})", "", ""))
                continue
            wall, user, system, peak = (
                statistics.median(sample[figure] for sample in samples) for figure in ("wall", "user", "system", "peak")
            )
            rows.append((*name, f"{wall:.2f}", f"{user + system:.2f}", f"{peak / 1e9:.2f}"))
    return table(("case", "program", "wall time [s]", "processor time [s]", "peak memory [GB]"), rows)


def main() -> None:
    """Measure and print the tables; insert them into the documentation after a complete run."""
    given = _arguments()
    real = [f"real{number + 1}" for number in range(len(given.survey))]
    possible = [*real, *MADE, "sample", "start"]
    wanted = given.only.split(",") if given.only else [key for key in possible if key not in EXTRA]
    if unknown := sorted(set(wanted) - set(possible)):
        sys.exit(f"--only names {', '.join(unknown)}; there are: {', '.join(possible)}")
    given.data.mkdir(parents=True, exist_ok=True)
    results = load(given)
    if not given.tables:
        measure(given, wanted, results)
    text = tables(results)
    print(text)
    page = given.page or (FIGURES if given.scale == 1.0 and not given.only and not given.tables else None)
    if page:
        page.write_text(text.strip() + "\n", encoding="utf-8")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--data", type=Path, default=HERE / "data", help="folder of surveys, layers and raw figures")
    add("--survey", type=Path, action="append", default=[], help="a real survey in metres; repeatable")
    add("--crs", action="append", default=[], help="its CRS if it has none; as often as --survey")
    add("--before", metavar="COMMAND", help="another bumpymap to compare with, as PATH/bumpymap")
    add("--rounds", type=int, default=5)
    add("--only", default="", metavar="CASE,...", help="some cases: real1, 20m-laz, 1000m-laz, start, ...")
    add("--tables", action="store_true", help="measure nothing, print the tables of the figures so far")
    add("--scale", type=float, default=1.0, help="share of the points, such as 0.01 for a quick test")
    add("--map-options", default="", metavar="TEXT", help="more options for bumpymap map")
    add("--page", type=Path, help=f"write the tables here too [{FIGURES.name} of docs/figures after a complete run]")
    given = parser.parse_args()
    if given.rounds < 1:
        parser.error(f"--rounds is {given.rounds}; it must be at least 1")
    for path in (*given.survey, *([Path(given.before)] if given.before else [])):
        if not path.is_file():
            parser.error(f"{path} is no file")
    return given


if __name__ == "__main__":
    main()
