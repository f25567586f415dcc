"""Every hostile file ends in time, within memory, with one message, and leaves nothing behind; or is skipped whole."""

import json

import numpy as np
import pytest
from corpus import PLACES, Case, hostile_files, odd_place
from corpus.files import bases, cloud, las_file, layout_of, patched, utm
from corpus.runner import MEMORY, Runner
from fuzz_readers import SEEDS, Judge
from small_surveys import layers_of, tiles_without_survey

from bumpymap.core import escape_controls

pytestmark = pytest.mark.slow

FILES = hostile_files()
NOISE = ("Traceback", "panicked at", "stack backtrace")


@pytest.fixture(scope="module")
def runner(tmp_path_factory):
    child = Runner(tmp_path_factory.mktemp("runner"))
    yield child
    child.close()


@pytest.fixture(scope="module")
def tiles_of(runner, tmp_path_factory):
    """Content of tiles.parquet of a valid survey: the layer that holds every height."""
    held = {}

    def look_up(name):
        if name not in held:
            place = tmp_path_factory.mktemp("base")
            (place / name).write_bytes(bases()[name])
            assert mapped(runner, place / name, place / "out", "--local").exit == 0
            held[name] = tiles_without_survey(place / "out" / "tiles.parquet")
        return held[name]

    return look_up


def mapped(runner, path, out, *options):
    return runner.run("map", "--out", out, *options, "--threads", "1", "--quiet", "--", path)


def everything(*folders):
    return {path for folder in folders for path in folder.rglob("*")}


def faults_of_ending(outcome):
    """What is wrong with how a command ended, whatever it was given."""
    faults = [] if outcome.exit in {0, 3} else [f"exit: {outcome.exit}"]
    faults += [f"says {word!r}" for word in NOISE if word in outcome.text]
    if outcome.peak > MEMORY:
        faults.append(f"takes {outcome.peak:,} bytes")
    if outcome.threads:
        faults.append(f"leaves threads: {', '.join(outcome.threads)}")
    return faults


def faults_of_refusal(outcome, shown):
    """A refusal is one message that names the file, beside warnings."""
    faults = []
    if len(outcome.errors) != 1:
        faults.append(f"{len(outcome.errors)} messages")
    elif escape_controls(shown) not in outcome.text[outcome.text.index("Error: ") :]:
        faults.append("a message that does not name the file")
    return faults


@pytest.mark.parametrize("name", bases())
def test_what_the_damage_starts_from_is_whole(runner, tmp_path, name):
    path = tmp_path / name
    path.write_bytes(bases()[name])
    outcome = mapped(runner, path, tmp_path / "out", "--local")
    assert (outcome.exit, faults_of_ending(outcome)) == (0, [])
    assert json.loads((tmp_path / "out" / "run.json").read_text())["counts"]["points"] == 400


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=case.name, marks=[pytest.mark.later] if number % 20 else [])
        for number, case in enumerate(FILES)
    ],
)
def test_hostile_file(runner, tiles_of, tmp_path, case: Case):
    path, out = tmp_path / case.name, tmp_path / "out"
    path.write_bytes(case.data)
    whole = tiles_of(case.base) if case.base else None
    before = everything(tmp_path, runner.scratch)
    told = runner.run("info", path)
    faults = [f"info: {fault}" for fault in faults_of_ending(told)]
    outcome = mapped(runner, path, out, "--local")
    faults += faults_of_ending(outcome)
    if outcome.exit not in case.exits:
        faults.append(f"exit {outcome.exit!r:.40}, expected one of {sorted(case.exits)}")
    if outcome.exit == 0:
        faults += [] if told.exit == 0 else ["info refuses what map maps"]
        if whole is not None and tiles_without_survey(out / "tiles.parquet") != whole:
            faults.append("other points than the undamaged file, without a word")
        left = {file for file in everything(out) if file.name.startswith(".")}
    else:
        faults += faults_of_refusal(outcome, case.name)
        left = everything(tmp_path, runner.scratch) - before
    faults += [f"left behind: {file.name}" for file in sorted(left)]
    assert not faults, outcome.text[:2000]


@pytest.mark.parametrize("name", PLACES)
def test_what_is_no_regular_file_or_has_an_odd_name(runner, tmp_path, monkeypatch, name):
    place = tmp_path / "place"
    place.mkdir()
    monkeypatch.chdir(place)
    path = odd_place(name, place)
    before = everything(tmp_path, runner.scratch)
    outcome = mapped(runner, path, tmp_path / "out", "--local")
    faults = faults_of_ending(outcome)
    if outcome.exit != 3:
        faults.append(f"exit {outcome.exit!r:.40}, expected 3")
    # A name with bytes that are no text is shown in some other way; what it ends in is still there.
    shown = {"name_not_utf8": "laz", "folder_of_a_bad_file": "inner.laz"}.get(name, path.name)
    faults += faults_of_refusal(outcome, shown)
    faults += [f"left behind: {file.name}" for file in sorted(everything(tmp_path, runner.scratch) - before)]
    assert not faults, outcome.text[:2000]


BAD = (
    "foreign-empty.laz",
    "foreign-random_behind_signature.las",
    "laz12-entries-bytes_2to31.laz",
    "laz12-chunk_1-endless_times.laz",
    "header-values_2to63.pcd",
    "header-endless_line.ply",
    "las12-geokeys-unit_of_angle.las",
)


def test_bad_files_and_one_that_breaks_in_its_middle_are_skipped_and_leave_no_point(runner, tmp_path):
    """One of them is LAZ in five chunks: other points than those of the good survey, on the same tiles."""
    folder = tmp_path / "surveys"
    folder.mkdir()
    (folder / "good.las").write_bytes(bases()["las12.las"])
    other = np.add(cloud(400, seed=1), [0.0, 0.0, 3.0])
    data = las_file(other, minor=4, fmt=7, chunks=80, vlrs=[utm()], wkt_bit=True)
    assert mapped(runner, folder, tmp_path / "alone").exit == 0
    (folder / "other.laz").write_bytes(data)
    assert mapped(runner, folder, tmp_path / "both").exit == 0
    assert layers_of(tmp_path / "both")["tiles.parquet"] != layers_of(tmp_path / "alone")["tiles.parquet"]
    held = {case.name: case.data for case in FILES}
    bad = {name: held[name] for name in BAD}
    bad["other.laz"] = patched(data, layout_of(data).chunks[2][0], "i", 2**31 - 1)
    for name, content in bad.items():
        (folder / name).write_bytes(content)
    outcome = mapped(runner, folder, tmp_path / "out", "--skip-bad")
    assert outcome.exit == 4, outcome.text
    assert layers_of(tmp_path / "out") == layers_of(tmp_path / "alone")
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert set(record["skipped"]) == {str(folder / name) for name in bad}
    assert all(path in message for path, message in record["skipped"].items())
    assert [entry["path"] for entry in record["inputs"]] == [str(folder / "good.las")]


# ---- what the fuzzer found stays mended ----


@pytest.fixture(scope="module")
def judge(tmp_path_factory):
    made = Judge(tmp_path_factory.mktemp("seeds"))
    yield made
    made.close()


@pytest.mark.later
@pytest.mark.parametrize("seed", sorted(SEEDS.iterdir()), ids=lambda seed: seed.name)
def test_what_the_fuzzer_found_is_read_or_refused_with_one_message(judge, seed):
    verdict = judge.verdict(seed.name, seed.read_bytes())
    assert not verdict.is_fault, verdict.where
