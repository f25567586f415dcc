"""Compare the time of bumpymap with reading only, with PDAL and with another bumpymap.

python tests/benchmarks/run.py --data FOLDER [--survey FILE --crs EPSG:CODE] [--before PATH/bumpymap] [--rounds 5]

Whole commands are timed alternately, round by round: reading, mapping, PDAL. The first run makes the surveys (6 GB on
disk). The raw figures are written to FOLDER/results.json; a complete run inserts the tables into the documentation.
The cases can be run in parts (--only); figures of other cases in results.json are kept. Cases of 100 and 1,000 million
points run only if they are named; those of 200 million and more run once, whatever --rounds is.
"""

import argparse
import hashlib
import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
from _cases import EXTRA, MADE, ONCE, Bench, Case, prepare
from _file_bytes import bytes_of, count_file_bytes
from _measure import Sample, run_timed, warm_page_cache
from _page import insert_tables, machine, tables

HERE = Path(__file__).resolve().parent
PAGE = HERE.parents[1] / "docs" / "pages" / "benchmarks.md"
_TRACED = "20m-las"
"""The case whose bytes are counted."""


def run_round(case: Case, results: dict[str, Any], peaks: dict[tuple[str, str], float]) -> None:
    """Run every program of a case once, and before the first round once more to sample its memory."""
    warm_page_cache(case.survey)
    with tempfile.TemporaryDirectory() as empty:
        env = {"NUMBA_CACHE_DIR": empty} if case.key == "start" else {}
        for side, command in case.sides.items():
            once = bool(env) or case.key in ONCE
            if not once and (case.key, side) not in peaks:
                peaks[case.key, side] = run_timed(command, memory=True).peak
            sample = run_timed(command, env, memory=once)
            sample = replace(sample, peak=peaks.get((case.key, side), sample.peak))
            _print_sample(case.key, side, sample)
            results["samples"][case.key].setdefault(side, []).append(sample.record())


def _print_sample(key: str, side: str, sample: Sample) -> None:
    times = f"{sample.wall:8.2f} s  {sample.user:8.2f} s user  {sample.system:8.2f} s system"
    sys.stderr.write(f"{key:14} {side:14} {times}  {sample.peak / 1e9:6.2f} GB\n")
    if sample.exit_code != 0:
        sys.stderr.write(f"  exit {sample.exit_code}: {sample.stderr_tail}\n")


def run_traced(case: Case, results: dict[str, Any]) -> None:
    """Count the bytes that each version reads, in runs that are not timed."""
    for side in ("map", "before"):
        if side in case.sides and (files := count_file_bytes(case.sides[side])) is not None:
            every = sum(each.read for each in files.values())
            results["bytes_read"].setdefault(case.key, {})[side] = {
                "survey": bytes_of(case.survey, files),
                "all": every,
            }


def load(given: argparse.Namespace) -> dict[str, Any]:
    """Return the figures so far if they were measured here, in these versions and at this scale; else none."""
    here = {"machine": machine(), "scale": given.scale}
    fresh = {"surveys": {}, "titles": {}, "samples": {}, "same_bits": {}, "bytes_read": {}}
    path = given.data / "results.json"
    if path.exists():
        old: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if all(old.get(key) == value for key, value in here.items()):
            return {**fresh, **old}
        kept = path.with_name("results-old.json")
        path.replace(kept)
        sys.stderr.write(f"other machine, versions or scale: the figures so far are in {kept}\n")
    return {**here, **fresh}


def save(data: Path, results: dict[str, Any]) -> None:
    """Write the raw figures so far next to the surveys."""
    beside = data / "results.json.part"
    beside.write_text(json.dumps(results, indent=1), encoding="utf-8")
    beside.replace(data / "results.json")


def check_layers(bench: Bench, results: dict[str, Any]) -> None:
    """Record the area of every survey, and whether layers that must be the same are the same."""
    sums, rows = {}, {}
    for case, sides in results["samples"].items():
        for side in sides:
            manifest = bench.out(case, side) / "run.json"
            if case in results["surveys"] and side.startswith(("map", "before")) and manifest.exists():
                run = json.loads(manifest.read_text(encoding="utf-8"))
                results["surveys"][case]["area_m2"] = run["counts"]["tiles"] * run["grid"]["tile_size_m"] ** 2
                sums[case, side] = {made["path"]: made["sha256"] for made in run["files"]}
                rows[case, side] = manifest.with_name("tiles.parquet")
    same = results["same_bits"]
    for (case, side), own in sums.items():
        plain, ordered = sums.get((case, "map")), rows.get((case.replace("shuffled", "laz"), side))
        if plain is not None and side != "map":
            kind = "another version" if side.startswith("before") else "other options"
            same[f"{case} {side}"] = [kind, own == plain]
        if ordered is not None and "shuffled" in case:
            # The layers name the file they were made from; the table of tiles holds all of their values.
            alike = _rows_digest(rows[case, side]) == _rows_digest(ordered)
            same[f"{case} {side}"] = ["another order of points", alike]


def _rows_digest(path: Path) -> str:
    """Return the SHA-256 of the rows of a table, without its metadata."""
    digest = hashlib.sha256()
    with pq.ParquetFile(path) as file:
        for batch in file.iter_batches():
            digest.update(batch.replace_schema_metadata(None).serialize())
    return digest.hexdigest()


def measure(given: argparse.Namespace, wanted: list[str], results: dict[str, Any]) -> None:
    """Run the rounds of the wanted cases; their figures replace earlier ones."""
    bench = Bench(given)
    cases = prepare(given, bench, wanted, results)
    for case in cases:
        results["samples"][case.key] = {}
    bench.warm_up()
    peaks: dict[tuple[str, str], float] = {}
    for number in range(given.rounds):
        sys.stderr.write(f"round {number + 1} of {given.rounds}\n")
        for case in cases:
            if number == 0 or case.key not in ONCE:
                run_round(case, results, peaks)
                save(given.data, results)
    for case in [case for case in cases if case.key == _TRACED]:
        run_traced(case, results)
    check_layers(bench, results)
    save(given.data, results)


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
    page = given.page or (PAGE if given.scale == 1.0 and not given.only and not given.tables else None)
    if page:
        insert_tables(page, text)


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
    add("--page", type=Path, help=f"insert the tables into this page [{PAGE.name} after a complete run]")
    given = parser.parse_args()
    if given.rounds < 1:
        parser.error(f"--rounds is {given.rounds}; it must be at least 1")
    if given.before and not Path(given.before).is_file():
        parser.error(f"--before {given.before} is no file")
    for survey in given.survey:
        if not survey.is_file():
            parser.error(f"--survey {survey} is no file")
    return given


if __name__ == "__main__":
    main()
