"""Compare the time of bumpymap with reading only, with PDAL and with the paper's method.

python tests/benchmarks/run.py --data FOLDER [--survey FILE --crs EPSG:CODE] [--rounds 5] [--only 20m-laz,20m-las]

Whole commands are timed alternately, round by round: reading, mapping, PDAL. The first run makes the surveys (6 GB on
disk). The raw figures are written to FOLDER/results.json; a complete run inserts the tables into the documentation.
"""

import argparse
import json
import shlex
import shutil
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from _measure import Sample, run_timed, warm_page_cache
from _page import insert_tables, machine, tables

HERE = Path(__file__).resolve().parent
PAGE = HERE.parents[1] / "docs" / "pages" / "benchmarks.md"
SAMPLE = HERE.parents[1] / "sample_data" / "quarry.laz"

_MILLION = 1_000_000
_MADE = {
    "10m-laz": (10, "sorted", "laz"),
    "20m-laz": (20, "sorted", "laz"),
    "20m-las": (20, "sorted", "las"),
    "20m-shuffled": (20, "shuffled", "laz"),
    "200m-laz": (200, "sorted", "laz"),
    "200m-shuffled": (200, "shuffled", "laz"),
}
"""Case -> million points, order, format."""
_COMPARED = ("20m-laz", "20m-las")
"""Synthetic surveys that the other programs read too."""
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
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
        self.command = Path(sys.executable).with_name("bumpymap")
        self.pdal = shutil.which("pdal")

    def out(self, key: str) -> Path:
        """Return the folder for the layers of a case."""
        return self.data / "out" / key

    def map(self, survey: Path, key: str, *more: str) -> list[str]:
        """Return the command that maps a survey."""
        out = str(self.out(key))
        return [str(self.command), "map", str(survey), "--out", out, "--overwrite", "--quiet", *more, *self.options]

    def read(self, survey: Path) -> list[str]:
        """Return the command that decodes every field (program a)."""
        return [sys.executable, str(HERE / "read_all.py"), str(survey)]

    def grid(self, survey: Path, name: str, **more: bool) -> list[str]:
        """Return the command that makes a 3 m raster with PDAL (program b), in streaming mode."""
        pipeline = self.data / "out" / f"{name}.json"
        pipeline.parent.mkdir(parents=True, exist_ok=True)
        writer = {"type": "writers.gdal", "filename": str(pipeline.with_suffix(".tif")), "resolution": 3.0, **more}
        stages = [{"type": "readers.las", "filename": str(survey)}, {**writer, "output_type": _STATISTICS}]
        pipeline.write_text(json.dumps(stages), encoding="utf-8")
        return [str(self.pdal), "pipeline", str(pipeline)]

    def compared(self, key: str, survey: Path, *more: str) -> Case:
        """Return the case with reading, mapping and, if PDAL is installed, its raster."""
        sides = {"read": self.read(survey), "map": self.map(survey, key, *more)}
        if self.pdal:
            sides["pdal"] = self.grid(survey, f"{key}_pdal")
            sides["pdal_bin"] = self.grid(survey, f"{key}_pdal_bin", binmode=True)
        return Case(key, survey, sides)

    def start(self) -> Case:
        """Return the case for startup time: help, and a first run without compiled kernels."""
        run = self.map(SAMPLE, "start")
        return Case("start", SAMPLE, {"first run": run, "second run": run, "--help": [str(self.command), "--help"]})


def make(data: Path, key: str, scale: float) -> dict[str, Any]:
    """Make a survey in a separate process; return its facts."""
    millions, order, kind = _MADE[key]
    points = str(max(1, round(millions * _MILLION * scale)))
    script = [sys.executable, str(HERE / "surveys.py"), "--data", str(data), "--points", points]
    return _answer([*script, "--order", order, "--format", kind])


def describe(survey: Path) -> dict[str, Any]:
    """Return the facts of a survey given by the user."""
    return _answer([sys.executable, str(HERE / "surveys.py"), "--facts", str(survey)])


def _answer(command: list[str], env: dict[str, str] | None = None) -> dict[str, Any]:
    done = run_timed(command, env)
    if done.exit_code != 0:
        sys.exit(f"{' '.join(command)} failed:\n{done.stderr_tail}")
    answer: dict[str, Any] = json.loads(done.output)
    return answer


def prepare(given: argparse.Namespace, bench: Bench, wanted: list[str], results: dict[str, Any]) -> list[Case]:
    """Make the surveys and list the selected cases."""
    cases = []
    for number, survey in enumerate(given.survey, start=1):
        key = f"real{number}"
        if key in wanted:
            crs = ["--crs", given.crs[number - 1]] if number <= len(given.crs) and given.crs[number - 1] else []
            results["surveys"][key] = describe(survey)
            results["titles"][key] = "real drone survey" + (f" {number}" if len(given.survey) > 1 else "")
            cases.append(bench.compared(key, survey, *crs))
    for key, (millions, order, kind) in _MADE.items():
        if key in wanted:
            fact = results["surveys"][key] = make(given.data, key, given.scale)
            path = Path(fact.pop("path"))
            results["titles"][key] = f"{millions * given.scale:g} million points, {order}, {kind.upper()}"
            plain = Case(key, path, {"map": bench.map(path, key)})
            cases.append(bench.compared(key, path) if key in _COMPARED else plain)
    if "start" in wanted:
        results["titles"]["start"] = "start"
        cases.append(bench.start())
    for fact in results["surveys"].values():
        fact.pop("path", None)
    return cases


def run_round(case: Case, results: dict[str, Any]) -> None:
    """Run every program of a case once."""
    warm_page_cache(case.survey)
    with tempfile.TemporaryDirectory() as empty:
        env = {"NUMBA_CACHE_DIR": empty} if case.key == "start" else {}
        for side, command in case.sides.items():
            sample = run_timed(command, env)
            _print_sample(case.key, side, sample)
            results["samples"].setdefault(case.key, {}).setdefault(side, []).append(sample.record())


def _print_sample(key: str, side: str, sample: Sample) -> None:
    figures = f"{sample.wall:8.2f} s  {sample.cpu:8.2f} s cpu  {sample.peak / 1e9:6.2f} GB"
    sys.stderr.write(f"{key:14} {side:11} {figures}\n")
    if sample.exit_code != 0:
        sys.stderr.write(f"  exit {sample.exit_code}: {sample.stderr_tail}\n")


def run_patches(cases: list[Case], results: dict[str, Any]) -> None:
    """Time the paper's method (program c) once on 200 tiles."""
    for case in cases:
        record = _answer([sys.executable, str(HERE / "paper_method.py"), str(case.survey)], _ONE_THREAD)
        results["patch"].setdefault(results["titles"][case.key], []).append(record)
        methods = {"ours": record["ours_ms"], **record["methods_ms"]}
        figures = "  ".join(f"{way} {value:.3f} ms" for way, value in methods.items())
        sys.stderr.write(f"{case.key:14} patches     {figures}\n")


def save(data: Path, results: dict[str, Any]) -> None:
    """Write the raw figures so far next to the surveys."""
    (data / "results.json").write_text(json.dumps(results, indent=1), encoding="utf-8")


def check_layers(cases: list[Case], bench: Bench, results: dict[str, Any]) -> None:
    """Record the area of every survey, and whether the order of points changed any bit of a layer."""
    sums = {}
    for case in cases:
        manifest = bench.out(case.key) / "run.json"
        if case.key in results["surveys"] and manifest.exists():
            run = json.loads(manifest.read_text(encoding="utf-8"))
            results["surveys"][case.key]["area_m2"] = run["counts"]["tiles"] * run["grid"]["tile_size_m"] ** 2
            sums[case.key] = {made["path"]: made["sha256"] for made in run["files"]}
    pairs = [("20m-laz", "20m-shuffled"), ("200m-laz", "200m-shuffled")]
    same = [sums[one] == sums[other] for one, other in pairs if one in sums and other in sums]
    results["same_bits"] = same or None


def main() -> None:
    """Run the rounds and print the tables; insert them into the documentation after a complete run."""
    given = _arguments()
    possible = [*(f"real{number + 1}" for number in range(len(given.survey))), *_MADE, "start", "patch"]
    wanted = given.only.split(",") if given.only else possible
    if unknown := sorted(set(wanted) - set(possible)):
        sys.exit(f"--only names {', '.join(unknown)}; there are: {', '.join(possible)}")
    bench = Bench(given)
    results: dict[str, Any] = {"machine": machine(), "rounds": given.rounds, "scale": given.scale}
    results |= {"surveys": {}, "titles": {}, "samples": {}, "patch": {}, "same_bits": None}
    cases = prepare(given, bench, wanted, results)
    compared = [case for case in cases if case.key == "20m-laz" or case.key.startswith("real")]
    given.data.mkdir(parents=True, exist_ok=True)
    for number in range(given.rounds):
        sys.stderr.write(f"round {number + 1} of {given.rounds}\n")
        for case in cases:
            run_round(case, results)
            save(given.data, results)
        if "patch" in wanted:
            run_patches(compared, results)
    check_layers(cases, bench, results)
    save(given.data, results)
    text = tables(results)
    print(text)
    page = given.page or (PAGE if given.scale == 1.0 and not given.only else None)
    if page:
        insert_tables(page, text)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=HERE / "data", help="folder of surveys, layers and raw figures")
    parser.add_argument("--survey", type=Path, action="append", default=[], help="a real survey in metres; repeatable")
    parser.add_argument("--crs", action="append", default=[], help="its CRS if it has none; as often as --survey")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", default="", metavar="CASE,...", help="some cases: real1, 20m-laz, start, patch, ...")
    parser.add_argument("--scale", type=float, default=1.0, help="share of the points, such as 0.01 for a quick test")
    parser.add_argument("--map-options", default="", metavar="TEXT", help="more options for bumpymap map")
    parser.add_argument(
        "--page", type=Path, help=f"insert the tables into this page [{PAGE.name} after a complete run]"
    )
    given = parser.parse_args()
    if given.rounds < 1:
        parser.error(f"--rounds is {given.rounds}; it must be at least 1")
    for survey in given.survey:
        if not survey.is_file():
            parser.error(f"--survey {survey} is no file")
    return given


if __name__ == "__main__":
    main()
