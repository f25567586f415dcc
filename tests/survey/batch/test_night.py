"""Whole batches: broken surveys among good ones, interrupted and continued, with the layers that `map` alone writes."""

import csv
import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from small_surveys import killed_at, run, write_broken, write_survey

from bumpymap.core import MapConfig, OutputError, locked
from bumpymap.layers.products import PRODUCT_NAMES
from bumpymap.survey import BatchConfig, map_surveys, run_batch
from bumpymap.survey.batch.run import MapTask, map_tasks

pytestmark = pytest.mark.slow

GOOD = ("a", "b", "north_s", "south_s")
LAYERS = tuple(name for name in PRODUCT_NAMES if name != "run.json")


@pytest.fixture(scope="module")
def surveys(tmp_path_factory):
    """Four good ones in two CRSs, and four that cannot be mapped."""
    folder = tmp_path_factory.mktemp("batch") / "flights"
    write_survey(folder / "a.laz")
    write_survey(folder / "b.las", epsg=32615, seed=1)
    write_survey(folder / "north" / "s.laz", seed=2, side=30.0)
    write_survey(folder / "south" / "s.laz", seed=3)
    write_survey(folder / "nowhere.laz", epsg=None)
    write_survey(folder / "empty.las", points=0)
    write_broken(folder / "broken.laz")
    (folder / "nothing.laz").touch()
    return folder


@pytest.fixture(scope="module")
def alone(surveys, tmp_path_factory):
    """Bytes of the layers of the good ones, each mapped by itself."""
    folder, places = tmp_path_factory.mktemp("alone"), ("a.laz", "b.las", "north/s.laz", "south/s.laz")
    for name, place in zip(GOOD, places, strict=True):
        map_surveys(MapConfig((surveys / place,), folder / name))
    return layers_in(folder)


def layers_in(folder):
    return {(name, layer): (folder / name / layer).read_bytes() for name in GOOD for layer in LAYERS}


def batch(*words, jobs=1, **how):
    return run("batch", *words, "--jobs", jobs, **how)


def table(folder):
    with (folder / "summary.csv").open(encoding="utf-8", newline="") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def statuses(folder):
    return {name: row["status"] for name, row in table(folder).items()}


@pytest.fixture(scope="module")
def night(surveys, tmp_path_factory):
    folder = tmp_path_factory.mktemp("done") / "night"
    batch(surveys, "--out", folder, jobs=2, code=4)
    return folder


def test_the_summary_says_what_the_layers_say(night, surveys, alone):
    assert layers_in(night) == alone
    rows = table(night)
    for name in GOOD:
        run = json.loads((night / name / "run.json").read_text(encoding="utf-8"))
        row, counts = rows[name], run["counts"]
        assert (int(row["points"]), int(row["tiles"])) == (20_000, counts["tiles"])
        assert float(row["density"]) == pytest.approx(20_000 / counts["tiles"] / 9, abs=1e-3)
        shares = [float(row[f"share_{of}"]) for of in ("smooth", "fair", "rough", "very_rough", "unknown")]
        assert sum(shares) == pytest.approx(1, abs=1e-5)
        assert shares[-1] == pytest.approx(counts["unknown"] / counts["tiles"], abs=1e-6)
        assert row["checksum"] == run["inputs"][0]["checksum"]
        assert (row["vehicle"], row["calibration"]) == ("warthog", run["calibration"]["id"])
        side = 30 if name == "north_s" else 20
        edges = [float(row[edge]) for edge in ("min_x", "min_y", "max_x", "max_y")]
        assert all(edge % 3 == 0 for edge in edges)
        assert edges[0] <= 500_001 < 500_001 + side <= edges[2] + 1e-6
        assert edges[1] <= 4_000_002 < 4_000_002 + side <= edges[3] + 1e-6
        assert edges[2] - edges[0] < side + 6
    assert {name: rows[name]["crs"] for name in GOOD} == dict.fromkeys(GOOD, "EPSG:32614") | {"b": "EPSG:32615"}
    assert "--crs EPSG:CODE" in rows["nowhere"]["message"]
    assert rows["broken"]["survey"] == str(surveys / "broken.laz")
    assert rows["broken"]["points"] == ""


@pytest.mark.usefixtures("batches_here")
def test_what_is_done_is_skipped_and_what_is_mended_is_mapped(tmp_path):
    """One has no CRS: `local`, given for it, keeps the maps of the others."""
    folder, out = tmp_path / "in", tmp_path / "o"
    write_survey(folder / "a.laz")
    write_broken(folder / "b.laz")
    write_survey(folder / "c.laz", epsg=None)
    batch(folder, "--out", out, code=4)
    assert statuses(out) == {"a": "done", "b": "failed", "c": "failed"}
    before = (out / "a" / "run.json").stat().st_mtime_ns
    write_survey(folder / "b.laz", seed=1)
    words = (folder, "--out", out, "--set", "local=true")
    batch(*words, code=0)
    assert statuses(out) == {"a": "already done", "b": "done", "c": "done"}
    assert (out / "a" / "run.json").stat().st_mtime_ns == before
    batch(*words, "--set", "align=off", code=3)
    assert "align was report, is off" in table(out)["a"]["message"]
    (tmp_path / "a.toml").write_text('align = "off"')
    batch(*words, "--config", tmp_path / "a.toml", "--overwrite", code=0)
    assert statuses(out) == dict.fromkeys("abc", "done")


@pytest.mark.usefixtures("batches_here")
def test_rows_of_a_table_have_their_own_settings(tmp_path):
    write_survey(tmp_path / "a.laz", epsg=None)
    (tmp_path / "bad.laz").touch()
    (tmp_path / "s.csv").write_text("survey,name,crs,local\na.laz,east,EPSG:32615,\nbad.laz,,,\n")
    batch(tmp_path / "s.csv", "--out", tmp_path / "o", "--set", "max_unknown=0", code=4)
    row = table(tmp_path / "o")["east"]
    assert (row["crs"], row["status"]) == ("EPSG:32615", "incomplete")
    assert "more than" in row["message"]
    assert "is empty" in table(tmp_path / "o")["bad"]["message"]


@pytest.mark.usefixtures("batches_here")
def test_a_crs_for_all_is_that_of_surveys_without_one_and_warnings_are_everywhere(tmp_path):
    write_survey(tmp_path / "in" / "own.laz")
    write_survey(tmp_path / "in" / "silent.laz", epsg=None)
    result = batch(tmp_path / "in", "--out", tmp_path / "o", "--crs", "EPSG:32615")
    rows = table(tmp_path / "o")
    assert {name: row["crs"] for name, row in rows.items()} == {"own": "EPSG:32614", "silent": "EPSG:32615"}
    assert rows["silent"]["warnings"] == ""
    warning = "WGS 84 / UTM zone 14N (EPSG:32614), and --crs EPSG:32615 is for surveys that have none"
    page = (tmp_path / "o" / "index.html").read_text(encoding="utf-8")
    assert all(warning in text for text in (rows["own"]["warnings"], result.stdout, result.stderr, page))
    assert "2 surveys: 2 done, 1 with warnings" in result.stdout
    page = (tmp_path / "o" / "own" / "report.html").read_text(encoding="utf-8")
    assert "EPSG:32614), and" in page
    assert str(tmp_path) not in page
    again = batch(tmp_path / "in", "--out", tmp_path / "o", "--crs", "EPSG:32615")
    assert "2 already done, 1 with warnings" in again.stdout


@pytest.mark.usefixtures("batches_here")
def test_an_interrupted_survey_is_begun_again_with_other_settings(surveys, alone, tmp_path):
    (tmp_path / "s.txt").write_text(f"{surveys / 'a.laz'}\n")
    left = tmp_path / "o" / "a"
    killed_at("survey.engine.run.decide_ground", left, surveys / "a.laz", "--align", "off")
    assert (left / ".bumpymap-run").is_dir()
    batch(tmp_path / "s.txt", "--out", tmp_path / "o", code=0)
    assert not (left / ".bumpymap-run").exists()
    assert {layer: (left / layer).read_bytes() for layer in LAYERS} == {layer: alone["a", layer] for layer in LAYERS}


def test_a_signal_leaves_a_summary(surveys, tmp_path):
    script = (
        "import os, sys\nfrom bumpymap.cli import main, map_command\nreporter = map_command._batch_reporter\n"
        f"map_command._batch_reporter = lambda progress: lambda row: os.kill(os.getpid(), {int(signal.SIGTERM)})\n"
        "sys.argv[0] = 'bumpymap'\nmain()"
    )
    words = [sys.executable, "-c", script, "batch", str(surveys), "--out", str(tmp_path / "o")]
    done = subprocess.run(words, check=False, capture_output=True, text=True, timeout=120)
    assert done.returncode == 143, done.stderr
    assert done.stderr.strip().endswith("Give the same command again to continue.")
    assert statuses(tmp_path / "o")["a"] == "done"
    assert sorted(statuses(tmp_path / "o").values()).count("not reached") == 7
    assert not list((tmp_path / "o").glob(".*"))


@pytest.mark.usefixtures("batches_here")
def test_nothing_of_others_is_touched(surveys, tmp_path):
    (tmp_path / "s.txt").write_text(f"{surveys / 'a.laz'}\n")
    mine = tmp_path / "mine"
    mine.mkdir()
    for name in ("summary.csv", "index.html", "collection.json", "run.json"):
        (mine / name).write_text("my own\n")
        batch(tmp_path / "s.txt", "--out", mine, code=3)
        assert [(path.name, path.read_text()) for path in mine.iterdir()] == [(name, "my own\n")]
        (mine / name).unlink()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (mine / "a").symlink_to(elsewhere)
    assert "is a link" in batch(tmp_path / "s.txt", "--out", mine).output
    (mine / "a").unlink()
    (mine / "a").mkdir()
    (mine / "a" / "cost.tif").write_text("my own")
    batch(tmp_path / "s.txt", "--out", mine, code=3)
    assert (mine / "a" / "cost.tif").read_text() == "my own"
    (mine / "summary.csv").unlink()
    (mine / "summary.csv").symlink_to(elsewhere / "table")
    batch(tmp_path / "s.txt", "--out", mine, code=3)
    assert not list(elsewhere.iterdir())


def test_one_batch_at_a_time(surveys, tmp_path):
    with locked(tmp_path / "o"), pytest.raises(OutputError, match="another run is writing"):
        run_batch(BatchConfig(surveys, tmp_path / "o"))
    assert not list((tmp_path / "o").iterdir())


@pytest.mark.usefixtures("batches_here")
def test_the_page_shows_layers_of_an_earlier_start_that_were_not_reached(surveys, tmp_path):
    (tmp_path / "s.txt").write_text(f"{surveys / 'a.laz'}\n{surveys / 'b.las'}\n")
    batch(tmp_path / "s.txt", "--out", tmp_path / "o", code=0)

    def end(row):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_batch(BatchConfig(tmp_path / "s.txt", tmp_path / "o", jobs=1), end)
    assert statuses(tmp_path / "o") == {"a": "already done", "b": "not reached"}
    assert "layers of an earlier start" in table(tmp_path / "o")["b"]["message"]
    assert table(tmp_path / "o")["b"]["points"] == "20000"
    assert (tmp_path / "o" / "index.html").read_text(encoding="utf-8").count("data:image/jpeg") == 2


@pytest.mark.usefixtures("batches_here")
def test_summary_and_page_are_written_during_the_night(surveys, tmp_path, monkeypatch):
    """So that those of a batch that is killed are not of the batch before."""
    monkeypatch.setattr("bumpymap.survey.batch.run._EVERY_S", -1.0)
    (tmp_path / "s.txt").write_text(f"{surveys / 'a.laz'}\n{surveys / 'nothing.laz'}\n")
    seen = []

    def look(row):
        page = (tmp_path / "o" / "index.html").read_text(encoding="utf-8")
        seen.append((statuses(tmp_path / "o"), "while the batch was running" in page))

    run_batch(BatchConfig(tmp_path / "s.txt", tmp_path / "o", jobs=1), look)
    assert seen == [({"a": "done", "nothing": status}, True) for status in ("not reached", "failed")]
    assert "while the batch" not in (tmp_path / "o" / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("jobs", [pytest.param(1, marks=pytest.mark.later), 2])
def test_a_process_maps_many_surveys_and_one_that_dies_fails_its_survey_alone(monkeypatch, jobs):
    monkeypatch.setattr("bumpymap.survey.batch.run._MODULE", "worker_of_a_batch")
    names = ["s", "a", "s2", "dies", "b", "raises", "dies_too", "c"]
    tasks = [MapTask(name, MapConfig((Path(f"{name}.laz"),), Path("o"))) for name in names]
    rows = [row for row, _ in map_tasks(tasks, jobs)]
    assert sorted(row.name for row in rows) == sorted(names)
    rows = {row.name: row for row in rows}
    assert {name for name, row in rows.items() if row.status == "done"} == {"s", "a", "s2", "b", "c"}
    assert len({rows[name].message for name in ("s", "a", "s2")}) <= jobs  # processes that mapped them
    assert "SIGKILL" in rows["dies"].message
    assert rows["dies"].survey == "dies.laz"
    assert "of no kind that is expected" in rows["raises"].message
