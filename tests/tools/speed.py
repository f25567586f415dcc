"""Guard the speed of `map`: processor time by stage, over that of reading the same survey alone.

    python tests/tools/speed.py [SURVEY [--crs EPSG:CODE]] [--rounds 5] [--keep]

Reading and mapping take turns, and medians are compared, so other programs on the machine matter little. A stage that
takes a quarter more than the table `speed.json` beside this file says is reported, and the exit code is 1. ``--keep``
writes what was measured into the table.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

HERE = Path(__file__).resolve().parent
TABLE = HERE / "speed.json"
SAMPLE = HERE.parents[1] / "sample_data" / "quarry.laz"
ALLOWED = 1.25
"""A stage may take so much more than the table says: runs of one version differ by a tenth."""
READ = """
import sys, laspy
with laspy.open(sys.argv[1], laz_backend=laspy.LazBackend.LazrsParallel) as reader:
    for _ in reader.chunk_iterator(1_000_000):
        pass
"""


class StageTimes:
    """A `Progress` that notes the processor time of this process and its children, s, when a stage begins."""

    def __init__(self):
        self.begun = {"start": 0.0}

    def start(self, stage, total):
        """Begin a stage."""
        self.begun.setdefault(stage, processor_time())

    def advance(self, steps):
        """Note nothing."""


def processor_time():
    """Return the processor time of this process and its children, alive or not, s."""
    own = psutil.Process()
    alive = (child.cpu_times() for child in own.children(recursive=True))
    ended = own.cpu_times()
    return (
        time.process_time()
        + ended.children_user
        + ended.children_system
        + sum(each.user + each.system for each in alive)
    )


def print_stages(survey, crs, out):
    """Map a survey as the command does, and print the processor time of each stage, s, as JSON."""
    from bumpymap.cli.map_command import ImportsAhead
    from bumpymap.core import MapConfig
    from bumpymap.survey import map_surveys

    times = StageTimes()
    map_surveys(MapConfig(surveys=(Path(survey),), out=Path(out), crs=crs), ImportsAhead(times))
    ends = [*list(times.begun.values())[1:], processor_time()]
    print(json.dumps({name: end - begin for (name, begin), end in zip(times.begun.items(), ends, strict=True)}))


def measured(survey, crs, rounds):
    """Return the ratio of each stage to reading alone; medians."""
    samples = []
    for _ in range(rounds):
        before = psutil.Process().cpu_times()
        subprocess.run([sys.executable, "-c", READ, survey], check=True)
        after = psutil.Process().cpu_times()
        read = sum(after[2:4]) - sum(before[2:4])
        with tempfile.TemporaryDirectory() as out:
            command = [sys.executable, __file__, survey, "--stages", out, *(["--crs", crs] if crs else [])]
            stages = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        samples.append({name: seconds / read for name, seconds in stages.items()})
    return {name: round(statistics.median(each[name] for each in samples), 2) for name in samples[0]}


def main():
    """Measure, compare with the table, and report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("survey", nargs="?", default=str(SAMPLE))
    parser.add_argument("--crs")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--keep", action="store_true")
    parser.add_argument("--stages", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.stages:
        print_stages(asked.survey, asked.crs, asked.stages)
        return
    table, name = json.loads(TABLE.read_text()), Path(asked.survey).name
    found, kept = measured(asked.survey, asked.crs, asked.rounds), table.get(name, {})
    slower = [stage for stage, ratio in found.items() if ratio > ALLOWED * kept.get(stage, ratio)]
    for stage, ratio in found.items():
        print(f"{stage:28} {ratio:6.2f} x reading alone; {kept.get(stage, '-')} in the table")
    if asked.keep:
        TABLE.write_text(json.dumps(table | {name: found}, indent=1) + "\n")
    elif slower:
        sys.exit(f"slower than in the table: {', '.join(slower)}")


if __name__ == "__main__":
    main()
