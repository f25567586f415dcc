"""Layers that go to a server: whole or not at all, recognised there, kept here if they could not be uploaded."""

import csv
import json
from dataclasses import replace

import pytest
from click.testing import CliRunner
from small_surveys import write_broken, write_survey

from bumpymap.cli import main
from bumpymap.core import OutputError
from bumpymap.core.config import MapConfig
from bumpymap.layers import RemoteFolder
from bumpymap.survey import BatchConfig, map_surveys
from bumpymap.survey.batch import one_survey
from bumpymap.survey.batch.one_survey import MapTask, map_one
from bumpymap.survey.batch.run import upload_summary

fsspec = pytest.importorskip("fsspec")
pytestmark = pytest.mark.slow
REFUSED = "Access Denied"


@pytest.fixture
def server(monkeypatch):
    """fsspec's memory as the server; the names of what is put there, in order; it can be told to refuse."""
    files = fsspec.filesystem("memory")
    put_file = files.put_file
    server = type("Server", (), {"files": files, "put": [], "refuses": None})()

    def put(source, target, **options):
        if target.rsplit("/", 1)[-1] == server.refuses:
            raise PermissionError(REFUSED)
        server.put.append(target.rsplit("/", 1)[-1])
        return put_file(source, target, **options)

    monkeypatch.setattr(type(files), "put_file", lambda _, *words, **options: put(*words, **options))
    yield server
    if files.exists("/night"):
        files.rm("/night", recursive=True)


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return write_survey(tmp_path_factory.mktemp("in") / "a.laz")


@pytest.fixture(scope="module")
def alone(survey, tmp_path_factory):
    folder = tmp_path_factory.mktemp("alone") / "a"
    map_surveys(MapConfig((survey,), folder))
    return folder


@pytest.fixture
def task(survey, tmp_path):
    return MapTask("a", MapConfig((survey,), tmp_path / "work" / "a"), RemoteFolder("memory://night/a"), 10_000)


def layers_of(server):
    return {path.rsplit("/", 1)[-1]: server.files.cat_file(path) for path in server.files.find("/night/a")}


def test_the_layers_are_those_of_a_map_and_run_json_is_last(server, task, alone):
    end = map_one(task)
    assert (end.row.status, end.row.message) == ("done", "")
    assert end.view.thumbnail
    there = layers_of(server)
    assert set(there) == {path.name for path in alone.iterdir()}
    assert {name for name, data in there.items() if data != (alone / name).read_bytes()} == {"run.json"}
    assert server.put[-1] == "run.json"
    assert not task.config.out.exists()


def test_what_is_there_is_recognised_without_its_layers(server, task, monkeypatch):
    first = map_one(task)
    server.put.clear()
    read = []
    monkeypatch.setattr(type(server.files), "get_file", lambda *words: read.append(words))
    again = map_one(replace(task, config=replace(task.config, threads=1, memory="600MB")))
    assert again.row == replace(first.row, status="already done")
    assert again.view == first.view
    assert (server.put, read) == ([], [])
    assert not task.config.out.exists()


def test_other_settings_and_missing_layers_are_refused_or_replace_what_is_there(server, task):
    map_one(task)
    server.put.clear()
    other = replace(task, config=replace(task.config, align="off"))
    refused = map_one(other).row
    assert refused.status == "failed"
    assert "memory://night/a already holds a complete run" in refused.message
    assert "align was report, is off" in refused.message
    assert server.put == []
    replacing = replace(task, config=replace(other.config, overwrite=True))
    assert map_one(replacing).row.status == "done"
    assert json.loads(layers_of(server)["run.json"])["settings"]["align"] == "off"
    assert map_one(replacing).row.status == "already done"
    server.files.rm("/night/a/cost.tif")
    row = map_one(other).row
    assert row.status == "failed"
    assert "cost.tif is missing or has another size" in row.message
    assert map_one(replacing).row.status == "done"
    assert "cost.tif" in layers_of(server)


@pytest.mark.parametrize("refuses", ["cost.tif", "run.json"])
def test_a_failed_upload_is_a_failed_survey_and_the_next_start_uploads_what_was_kept(server, task, refuses):
    server.refuses = refuses
    row = map_one(task).row
    assert row.status == "failed"
    assert f"cannot write memory://night/a/{refuses}: {REFUSED}" in row.message
    assert f"The layers are in {task.config.out}" in row.message
    assert "run.json" not in layers_of(server)
    kept = (task.config.out / "run.json").read_bytes()
    server.refuses = None
    assert map_one(task).row.status == "done"
    assert layers_of(server)["run.json"] == kept  # not mapped a second time
    assert not task.config.out.exists()


def test_layers_that_a_start_killed_after_its_upload_has_left_are_removed(server, task, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(one_survey, "remove_path", lambda _: None)
        map_one(task)
    assert (task.config.out / "run.json").is_file()
    other = replace(task, config=replace(task.config, align="off"))
    assert map_one(other).row.status == "failed"
    assert (task.config.out / "run.json").is_file()
    assert map_one(task).row.status == "already done"
    assert not task.config.out.exists()


def test_links_and_hidden_files_stay_here(server, tmp_path):
    for name in ("a.tif", "run.json", ".hidden"):
        (tmp_path / name).write_text(name)
    (tmp_path / "link.tif").symlink_to(tmp_path / "a.tif")
    (tmp_path / "folder").mkdir()
    RemoteFolder("memory://night/a").upload(tmp_path, "run.json")
    assert server.put == ["a.tif", "run.json"]


def batch(*words):
    return CliRunner().invoke(main, ["batch", *map(str, words)])


def test_a_whole_batch(tmp_path, survey):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.laz").symlink_to(survey)
    write_broken(tmp_path / "in" / "b.laz")
    there, scratch = tmp_path / "store" / "night", tmp_path / "scratch"
    there.parent.mkdir()
    words = (tmp_path / "in", "--out", there.as_uri(), "--set", f"scratch={scratch}")
    for number, status in enumerate(("done", "already done"), 1):
        result = batch(*words)
        assert result.exit_code == 4, result.output
        assert f"{there.as_uri()}/index.html" in result.stdout
        assert sorted(path.name for path in there.iterdir()) == [
            "a", "index.html", "log.jsonl", "summary.csv", "summary.parquet",
        ]  # fmt: skip
        with (there / "summary.csv").open(encoding="utf-8", newline="") as file:
            assert [row["status"] for row in csv.DictReader(file)] == [status, "failed"]
        page = (there / "index.html").read_text(encoding="utf-8")
        assert "data:image/png" in page
        assert "<h1>night</h1>" in page
        log = (there / "log.jsonl").read_text(encoding="utf-8").splitlines()
        assert [json.loads(line)["event"] for line in log].count("start") == number
        assert list(scratch.iterdir()) == []


def test_files_of_others_are_not_replaced(tmp_path, survey):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.laz").symlink_to(survey)
    there = tmp_path / "night"
    there.mkdir()
    for name, words in (("index.html", "no batch has written"), ("run.json", "layers of one map")):
        (there / name).write_text("mine")
        result = batch(tmp_path / "in", "--out", there.as_uri(), "--set", f"scratch={tmp_path / 'scratch'}")
        assert result.exit_code == 3
        assert words in result.stderr
        assert there.as_uri() in result.stderr
        assert [path.read_text() for path in there.iterdir()] == ["mine"]
        (there / name).unlink()
        assert list((tmp_path / "scratch").iterdir()) == []


def test_the_working_folder_is_the_same_at_every_start_and_is_not_a_link(tmp_path, survey):
    out = (tmp_path / "night").as_uri()
    one = BatchConfig(tmp_path, out, given={"scratch": tmp_path}).folder
    assert one == BatchConfig(tmp_path, f"{out}/", given={"scratch": tmp_path}).folder
    assert one != BatchConfig(tmp_path, f"{out}_2", given={"scratch": tmp_path}).folder
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    one.symlink_to(elsewhere)
    (tmp_path / "s.txt").write_text(f"{survey}\n")
    result = batch(tmp_path / "s.txt", "--out", out, "--set", f"scratch={tmp_path}")
    assert result.exit_code == 3
    assert "is a link or belongs to another user" in result.stderr
    assert list(elsewhere.iterdir()) == []


def test_a_survey_is_not_uploaded_to_the_folder_of_another(server, tmp_path):
    """fsspec takes what follows :: for another address: site::b would be uploaded to site."""
    source = tmp_path / "in"
    source.mkdir()
    write_survey(source / "site::b.laz")
    refused = CliRunner().invoke(
        main, ["batch", str(source), "--out", "memory://night", "--set", f"scratch={tmp_path}"]
    )
    assert refused.exit_code == 2
    assert "the folder site::b cannot be on a server" in refused.output
    assert not server.files.exists("/night")
    assert list(tmp_path.iterdir()) == [source]


def test_a_failed_upload_of_the_summary_keeps_it(server, tmp_path):
    (tmp_path / "index.html").write_text("page")
    server.refuses = "index.html"
    with pytest.raises(OutputError, match=f"The summary is in {tmp_path}"):
        upload_summary(RemoteFolder("memory://night"), tmp_path)
    assert (tmp_path / "index.html").exists()
