"""`bumpymap diff` as a user gives it, on two surveys of a made-up site."""

import json

import pytest
from click.testing import CliRunner
from route_maps import write_folder
from survey_pairs import survey

from bumpymap.cli import main


@pytest.fixture(scope="module")
def surveys(tmp_path_factory):
    root = tmp_path_factory.mktemp("diff")
    made = {"may": survey(1), "june": survey(2, rut=0.1, c_r=3.0)}
    return [write_folder(root / name, one) for name, one in made.items()]


def run(*words):
    return CliRunner().invoke(main, ["diff", *(str(word) for word in words)])


def test_tables_and_files(surveys, tmp_path):
    done = run(*surveys, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "1,200 tiles are in both surveys, 1,200 compared" in done.output
    assert "rougher" in done.output
    assert "3 very rough" in done.output
    assert "change.tif, change.geojson, change.json, change.qml, report.html" in done.output
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"change.tif", "change.json", "report.html"}
    assert run(*surveys, "--out", tmp_path / "out").exit_code != 0
    assert run(*surveys, "--out", tmp_path / "out", "--overwrite", "--quiet").output == ""


def test_a_record_for_machines(surveys):
    done = run(*surveys, "--json", "--set", "min_tiles=3", "--set", "fdr=0.1")
    (line,) = [text for text in done.stdout.splitlines() if '"counts"' in text]
    record = json.loads(line)
    assert record["counts"]["changed"] >= 36
    assert record["files"] == []
    assert sum(map(sum, record["classes"]["tiles_before_after"])) == 1_200


def test_a_folder_without_layers(surveys, tmp_path):
    done = run(surveys[0], tmp_path)
    assert done.exit_code == 3
    assert "holds no complete run" in done.output
