"""Deliberate faults: each is put into a copy of the sources, alone, and tests of its room must fail.

    python tests/tools/faults.py [--found FILE.jsonl] [ROOM...]

The faults are those of faults.txt: a file, a text that is in it once, what is put in its place, and the tests, apart by
``~~``. What finds each is kept in the file, line by line; a run that was broken off goes on where it was. The tests are
those of `make test`: none that is marked later.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PARTS = ("bumpymap", "docs", "sample_data", "tests", "tiles", "pyproject.toml", "README.md")


def faults():
    """The faults, as [file, old text, new text, tests]; a line end in a text is written as a backslash and n."""
    lines = Path(__file__).with_suffix(".txt").read_text(encoding="utf-8").splitlines()
    return [[part.replace("\\n", "\n") for part in line.split(" ~~ ")] for line in lines]


def failed_test(place, path, old, new, tests):
    """Name of the first test that fails with a fault in the copy at ``place``, empty if none does."""
    file = place / path
    text = file.read_text(encoding="utf-8")
    if text.count(old) != 1:
        sys.exit(f"{path} holds {text.count(old)} times what a fault replaces: {old}. Change the line of faults.txt")
    file.write_text(text.replace(old, new), encoding="utf-8")
    if file.suffix in {".cpp", ".hpp"}:
        subprocess.run(["cmake", "--build", "build"], cwd=place, stdout=subprocess.DEVNULL, check=True)
    paths = os.pathsep.join([str(place), str(place / "tiles")])
    options = ["-q", "-x", "-p", "no:cacheprovider", "-m", "not later", "--tb", "no", *tests.split()]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options],
        cwd=place,
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
    )
    file.write_text(text, encoding="utf-8")
    if done.returncode not in {0, 1}:
        sys.exit(f"the tests {tests} did not run: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    found = [line.split()[1] for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return found[0] if found else ""


def try_faults(place, found, rooms):
    """Try each fault that the file does not hold yet, and print what finds it."""
    lines = found.read_text(encoding="utf-8").splitlines() if found.exists() else []
    known = {tuple(json.loads(line)[:3]): json.loads(line)[3] for line in lines}
    for path, old, new, tests in faults():
        room, fault = Path(path).parts[1], (path, old, new)
        if rooms and room not in rooms:
            continue
        if fault not in known:
            known[fault] = failed_test(place, *fault, tests)
            with found.open("a", encoding="utf-8") as file:
                file.write(json.dumps([*fault, known[fault]]) + "\n")
        print(f"{room:10} {known[fault] or 'NOT FOUND':80} {path}: {old.strip()} -> {new.strip()}", flush=True)


def main():
    """Copy the sources, and try the faults in the copy."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--found", type=Path, default=Path("faults.jsonl"))
    parser.add_argument("rooms", nargs="*")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        for part in PARTS:
            copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy2
            copy(ROOT / part, Path(place) / part)
        python = f"-DPython_EXECUTABLE={sys.executable}"
        for words in (["-S", "tiles", "-B", "build", "-G", "Ninja", python], ["--build", "build"]):
            subprocess.run(["cmake", *words], cwd=place, stdout=subprocess.DEVNULL, check=True)
        try_faults(Path(place), given.found, given.rooms)


if __name__ == "__main__":
    main()
