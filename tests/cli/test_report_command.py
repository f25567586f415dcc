"""`bumpymap report` as a user gives it."""

import json

import pytest
from click.testing import CliRunner
from cost_maps import make_field
from route_maps import write_folder

from bumpymap.cli import main


@pytest.fixture(scope="module")
def layers(tmp_path_factory):
    root = tmp_path_factory.mktemp("report")
    return [write_folder(root / name, make_field(12, 9, seed=seed)) for seed, name in enumerate(("may", "june"))]


def run(*words, standalone_mode=False):
    return CliRunner().invoke(main, ["report", *map(str, words)], standalone_mode=standalone_mode)


def test_the_page_is_made_again_and_its_place_is_said(layers):
    page = layers[0] / "report.html"
    before = page.read_bytes()
    page.unlink()
    done = run(layers[0])
    assert done.exit_code == 0, done.output
    assert done.output.split() == ["Open", str(page), "in", "a", "browser."]
    assert page.read_bytes() == before
    assert run(layers[0], "--quiet").output == ""
    done = run(layers[0], "--json")
    assert json.loads(done.stdout.splitlines()[-1]) == {"report": str(page), "bytes": len(before)}


def test_the_page_of_a_comparison_is_made_again(layers, tmp_path):
    assert (
        CliRunner().invoke(main, ["diff", str(layers[0]), str(layers[0]), "--out", str(tmp_path / "d")]).exit_code == 0
    )
    page = tmp_path / "d" / "report.html"
    before = page.read_bytes()
    page.unlink()
    done = run(tmp_path / "d")
    assert done.exit_code == 0, done.output
    assert page.read_bytes() == before
    done = run(tmp_path / "d", "--route", "x", standalone_mode=True)
    assert done.exit_code == 2
    assert "--route" in done.output


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        ([], 2, "Missing argument 'LAYERS'"),
        (["may", "--out", "a.json"], 2, "ends in .html"),
        (["may", "--route", "june"], 3, "--route"),
        (["nothing"], 3, "there is no folder"),
    ],
)
def test_what_cannot_be_made_says_why(layers, tmp_path, monkeypatch, words, code, told):
    monkeypatch.chdir(layers[0].parent)
    done = run(*words, standalone_mode=True)
    assert done.exit_code == code, done.output
    assert told in " ".join(done.output.split())
