"""Batches of surveys as a night has them: killed and continued, and against a shell loop of `map`.

python tests/benchmarks/nights.py killed --data FOLDER [--real ../shared/data/surveys] [--jobs 2] [--seed 1]
python tests/benchmarks/nights.py many --data FOLDER [--surveys 50] [--points 1000000] [--jobs 2]

`killed`: 12 surveys, of which two are broken, one is empty and one has no CRS. Two starts are ended by SIGKILL while a
survey is being mapped; the third goes to the end. Every layer must have the bytes of a `map` of that survey alone, what
was done before a kill must not be written again, and the summary must say what became of each. `many`: small surveys,
once by a shell loop of `map` and once by `batch`. The exit code is 1 if anything is not as it must be.
"""

import argparse
import csv
import json
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
from surveys import Survey, make

from bumpymap.layers.products import PRODUCT_NAMES

BUMPYMAP = str(Path(sys.executable).with_name("bumpymap"))
SAMPLE = Path(__file__).resolve().parents[2] / "sample_data" / "quarry.laz"
_REAL = ("godie_espacio.laz", "bcts_adjoining/bcts_1.laz", "bcts_adjoining/bcts_2.laz", "bcts_adjoining/bcts_3.laz")
_CRS = {"godie_espacio.laz": "EPSG:32614"}
"""Of a real one that states none."""
_LIST = "flights.csv"
_MADE = (Survey(300_000, "sorted", "laz", 1), Survey(400_000, "sorted", "las", 2), Survey(500_000, "sorted", "copc", 3))
_MORE = tuple(Survey(250_000 + 50_000 * seed, "sorted", "laz", seed) for seed in range(4, 8))
"""Instead of the real ones, if there are none."""
_LAYERS = tuple(name for name in PRODUCT_NAMES if name != "run.json")
_KILLS_AFTER = (2, 5)
"""Finished surveys after which the first and the second start are killed, while the next is being mapped."""
_MOST_WAIT_S = 1800.0


def twelve(folder: Path, made: Path, real: Path | None) -> dict[str, str]:
    """Put twelve surveys and a list of them into a folder; return name -> status, as the summary must say."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    places = [make(survey, made) for survey in (*_MADE, *(() if real else _MORE))]
    places += [SAMPLE, *((real / name for name in _REAL) if real else ())]
    for place in places:
        (folder / place.name).symlink_to(place.absolute())
    whole = places[0].read_bytes()
    (folder / "truncated.laz").write_bytes(whole[: len(whole) // 2])
    (folder / "text.las").write_text("this is no point cloud\n", encoding="utf-8")
    laspy.LasData(laspy.LasHeader(point_format=6, version="1.4")).write(folder / "no_points.las")
    with laspy.open(places[0]) as file:
        las = file.read()
    las.header.vlrs.clear()
    las.write(folder / "no_crs.laz")
    good = {place.name.removesuffix(".laz").removesuffix(".las").removesuffix(".copc"): "done" for place in places}
    lines = [f"{path.name},{_CRS.get(path.name, '')}" for path in sorted(folder.iterdir())]
    (folder / _LIST).write_text("\n".join(["survey,crs", *lines]) + "\n", encoding="utf-8")
    return good | dict.fromkeys(("truncated", "text", "no_points", "no_crs"), "failed")


def killed(given: argparse.Namespace) -> dict[str, Any]:
    """Run the night that is killed twice; return its figures."""
    source, night, alone = (given.data / name for name in ("flights", "night", "alone"))
    wanted = twelve(source, given.data / "made", given.real)
    for folder in (night, alone):
        shutil.rmtree(folder, ignore_errors=True)
    draw, faults, starts = random.Random(given.seed), [], []
    words = [BUMPYMAP, "batch", str(source / _LIST), "--out", str(night), "--jobs", str(given.jobs), "--quiet"]
    before: dict[str, int] = {}
    for after in _KILLS_AFTER:
        starts.append(_killed(words, night, lambda after=after: _finished(night) >= after, draw.uniform(0.1, 1.5)))
        now = _written(night)
        faults += [f"{name} was written again" for name, when in before.items() if now.get(name) != when]
        before = now
        starts[-1]["done"] = len(before)
    begin = time.perf_counter()
    last = subprocess.run(words, capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - begin
    faults += [f"exit code {last.returncode}"] if last.returncode != 4 else []
    now = _written(night)
    faults += [f"{name} was written again" for name, when in before.items() if now.get(name) != when]
    with (night / "summary.csv").open(encoding="utf-8", newline="") as file:
        said = {row["name"]: row["status"] for row in csv.DictReader(file)}
    must = {name: "already done" if name in before else status for name, status in wanted.items()}
    faults += [f"{name} is {said.get(name)}, not {status}" for name, status in must.items() if said.get(name) != status]
    faults += [f"{name} is missing" for name in ("index.html", "summary.parquet", "log.jsonl")
               if not (night / name).exists()]  # fmt: skip
    compared = 0
    for name in (name for name, status in wanted.items() if status == "done"):
        (place,) = [path for path in source.iterdir() if path.name.split(".")[0] == name]
        own = ["--crs", _CRS[place.name]] if place.name in _CRS else []
        subprocess.run([BUMPYMAP, "map", str(place), "--out", str(alone / name), "--quiet", *own], check=True)
        for layer in _LAYERS:
            compared += 1
            if (night / name / layer).read_bytes() != (alone / name / layer).read_bytes():
                faults.append(f"{name}/{layer} differs")
    return {"surveys": len(wanted), "starts_killed": starts, "last_start_s": round(seconds, 1),
            "already_done": len(before), "mapped_by_the_last": len(now) - len(before), "layers_compared": compared,
            "exit_code": last.returncode, "faults": faults}  # fmt: skip


def many(given: argparse.Namespace) -> dict[str, Any]:
    """Map small surveys by a shell loop and by a batch; return both times."""
    made, source = given.data / "made", given.data / "small"
    shutil.rmtree(source, ignore_errors=True)
    source.mkdir(parents=True)
    for seed in range(given.surveys):
        place = make(Survey(given.points, "sorted", "laz", seed + 100), made)
        (source / place.name).symlink_to(place.absolute())
    each = f'"{BUMPYMAP}" map "$f" --out "{given.data}/loop/$(basename "$f" .laz)" --quiet'
    loop = f'for f in "{source}"/*.laz; do {each}; done'
    batch = [BUMPYMAP, "batch", str(source), "--out", str(given.data / "batch"), "--jobs", str(given.jobs), "--quiet"]
    times = {}
    for name, command in (("loop", ["sh", "-c", loop]), ("batch", batch)):
        shutil.rmtree(given.data / name, ignore_errors=True)
        begin = time.perf_counter()
        subprocess.run(command, check=True)
        times[name] = time.perf_counter() - begin
    differing = [
        f"{path.name}/{layer} differs"
        for path in sorted((given.data / "loop").iterdir())
        for layer in _LAYERS
        if (path / layer).read_bytes() != (given.data / "batch" / path.name / layer).read_bytes()
    ]
    return {"surveys": given.surveys, "points": given.points, "jobs": given.jobs, "loop_s": round(times["loop"], 1),
            "batch_s": round(times["batch"], 1), "ratio": round(times["batch"] / times["loop"], 3),
            "faults": differing}  # fmt: skip


def _killed(words: list[str], night: Path, is_time: Callable[[], bool], later: float) -> dict[str, Any]:
    """Start a batch, and kill it so many seconds after it is time; return how long it ran and what it was doing."""
    begin = time.perf_counter()
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while not is_time() and process.poll() is None and time.perf_counter() - begin < _MOST_WAIT_S:
        time.sleep(0.02)
    time.sleep(later)
    process.send_signal(signal.SIGKILL)
    if process.wait() != -signal.SIGKILL:
        sys.exit("the batch ended before it could be killed: give more or larger surveys")
    seconds = time.perf_counter() - begin
    time.sleep(2.0)  # its workers notice it
    under_way = sorted(path.parent.name for path in night.glob("*/.bumpymap-run"))
    return {"seconds": round(seconds, 1), "under_way": under_way}


def _finished(night: Path) -> int:
    return sum(not (path.parent / ".bumpymap-run").exists() for path in night.glob("*/run.json"))


def _written(night: Path) -> dict[str, int]:
    """Return when each finished survey was written."""
    found = {path.parent: path.stat().st_mtime_ns for path in night.glob("*/run.json")}
    return {folder.name: when for folder, when in found.items() if not (folder / ".bumpymap-run").exists()}


def main() -> None:
    """Run one of the two; print a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("killed", "many"))
    parser.add_argument("--data", type=Path, default=Path(__file__).with_name("data"), help="folder of the surveys")
    parser.add_argument("--real", type=Path, help="folder of the real surveys; without it, all are made up")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--surveys", type=int, default=50)
    parser.add_argument("--points", type=int, default=1_000_000)
    given = parser.parse_args()
    given.data = given.data.absolute()
    found = killed(given) if given.what == "killed" else many(given)
    print(json.dumps(found))
    sys.exit(bool(found["faults"]))


if __name__ == "__main__":
    main()
