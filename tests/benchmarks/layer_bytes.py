"""Write the SHA-256 of all layers of a fixed set of surveys and scans to a list, or compare them with a list.

Use it to check that a change of the code does not change the bytes of layers (except run.json and scan.json):

python tests/benchmarks/layer_bytes.py --data DATA --write before.json
python tests/benchmarks/layer_bytes.py --data DATA --compare before.json

DATA contains ``surveys`` and ``scans``; runs with missing inputs are skipped with a message.
"""

import argparse
import hashlib
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"
MANIFESTS = ("run.json", "scan.json")

RUNS: dict[str, tuple[str, ...]] = {
    "sample": ("map", "SAMPLE/quarry.laz"),
    "sample ply": ("map", "SAMPLE/quarry_part.ply", "--local"),
    "sample paper": ("map", "SAMPLE/quarry.laz", "--set", "compat=paper"),
    "sample table": ("map", "SAMPLE/quarry.laz", "--set", "rating=table"),
    "sample rover": ("map", "SAMPLE/quarry.laz", "--vehicle", "small_rover"),
    "godie": ("map", "DATA/surveys/godie_espacio.laz", "--crs", "EPSG:32614"),
    "godie paper": ("map", "DATA/surveys/godie_espacio.laz", "--crs", "EPSG:32614", "--set", "compat=paper"),
    "godie table": ("map", "DATA/surveys/godie_espacio.laz", "--crs", "EPSG:32614", "--set", "rating=table"),
    "bcts all": ("map", "DATA/surveys/bcts_adjoining", "--ground", "all"),
    "bcts csf": ("map", "DATA/surveys/bcts_adjoining", "--ground", "csf"),
    "scan husky": ("scan", "DATA/scans/monoforce/husky"),
    "scan 128": ("scan", "DATA/scans/patchwork_128ch/000000.pcd", "--method", "filter", "--pictures"),
    "scan kitti": ("scan", "DATA/scans/kitti_labelled"),
}
"""Arguments of each run; SAMPLE and DATA are folders."""


def hashes(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file in a folder except the manifests, by relative path."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name not in MANIFESTS)
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def make(arguments: tuple[str, ...], data: Path, out: Path) -> dict[str, str] | None:
    """Run one command and return the hashes of its output; None if an input is missing."""
    words = [word.replace("SAMPLE", str(SAMPLE)).replace("DATA", str(data)) for word in arguments]
    if any("/" in word and not Path(word).exists() for word in words):
        return None
    command = [sys.executable, "-c", "from bumpymap.cli import main; main()", *words, "--out", str(out), "--quiet"]
    subprocess.run(command, check=True)
    return hashes(out)


def differences(before: dict[str, dict[str, str]], now: dict[str, dict[str, str]]) -> list[str]:
    """List layers that differ, are missing or are new."""
    lines = []
    for run in sorted({*before, *now}):
        old, new = before.get(run), now.get(run)
        if old is None or new is None:
            lines.append(f"{run}: only in {'this list' if old is None else 'the list to compare with'}")
            continue
        for name in sorted({*old, *new}):
            if old.get(name) != new.get(name):
                word = "new" if name not in old else "missing" if name not in new else "different bytes"
                lines.append(f"{run}: {name}: {word}")
    return lines


def main() -> int:
    """Make the layers; write or compare the list."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder with surveys/ and scans/")
    parser.add_argument("--only", action="append", help="name of a run; repeatable")
    group = parser.add_mutually_exclusive_group(required=True)
    group.add_argument("--write", type=Path, metavar="FILE")
    group.add_argument("--compare", type=Path, metavar="FILE")
    options = parser.parse_args()
    scratch = Path(tempfile.mkdtemp(prefix="layer-bytes-"))
    found: dict[str, dict[str, str]] = {}
    try:
        for number, (name, arguments) in enumerate(RUNS.items()):
            if options.only and name not in options.only:
                continue
            made = make(arguments, options.data.resolve(), scratch / str(number))
            print(f"{name}: {'skipped, its input is missing' if made is None else f'{len(made)} files'}", flush=True)
            if made is not None:
                found[name] = made
            shutil.rmtree(scratch / str(number), ignore_errors=True)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    if options.write:
        options.write.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        return 0
    before = json.loads(options.compare.read_text(encoding="utf-8"))
    lines = differences({name: before[name] for name in before if not options.only or name in options.only}, found)
    print("\n".join(lines) or "same bytes")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
