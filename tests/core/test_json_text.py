"""JSON of others: however deep it is nested, one message follows."""

import pytest
from click.testing import CliRunner

from bumpymap.cli import main
from bumpymap.core.files import Each, Nullable, Number, parse_json, shape_fault
from bumpymap.core.run_folder import RunFolder, work_folder

DEPTHS = [51, 200_000]


def nested(depth, opening="["):
    closing = {"[": "]", '{"a":': "}"}[opening]
    return opening * depth + "1" + closing * depth


SHAPE = {"a": Number(0, 9, whole=True), "b?": [str], "c?": (Nullable(Number()),) * 2, "d?": Each({"e": bool})}


@pytest.mark.parametrize(
    "value",
    [{"a": 0}, {"a": 9, "more": None}, {"a": 1, "b": [], "c": [None, 0.5], "d": {"x": {"e": True}}}],
)
def test_a_value_of_the_declared_shape_has_no_fault(value):
    assert shape_fault(value, SHAPE) == ""


@pytest.mark.parametrize(
    ("value", "named"),
    [
        (5, "it"),
        (None, "it"),
        ({}, "it"),
        ({"a": True}, "a"),
        ({"a": 10}, "a"),
        ({"a": 1.5}, "a"),
        ({"a": 1, "b": "x"}, "b"),
        ({"a": 1, "b": ["x", 2]}, "b.1"),
        ({"a": 1, "c": [1]}, "c"),
        ({"a": 1, "c": [1, float("nan")]}, "c.1"),
        ({"a": 1, "c": [1, float("inf")]}, "c.1"),
        ({"a": 1, "d": {"x": {"e": 1}}}, "d.x.e"),
    ],
)
def test_the_first_fault_of_a_shape_is_named(value, named):
    assert shape_fault(value, SHAPE).startswith(f"{named} is ")


@pytest.mark.parametrize("spec", ['{"inputs": 5, "settings": {}, "made with": {}}', '{"settings": "x"}', "[1]", "{"])
def test_a_damaged_run_spec_is_not_resumed(tmp_path, spec):
    folder = work_folder(tmp_path)
    folder.mkdir(mode=0o700)
    (folder / "run_spec.json").write_text(spec)
    now = {"inputs": {"a.las": {"size": 1}}, "settings": {"x": 1}, "made with": {}}
    with RunFolder.opened(tmp_path, now, overwrite=False, finished=lambda _: True, advice="") as run:
        assert not run.resumed


@pytest.mark.parametrize("opening", ["[", '{"a":'])
@pytest.mark.parametrize("depth", DEPTHS)
def test_what_is_deep_is_refused(depth, opening):
    with pytest.raises(ValueError, match="more than 50 deep"):
        parse_json(nested(depth, opening))


NAMES = ["a\0b", "n" * 300, "é" * 128]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "words",
    [
        ["map", "NAME", "--out", "o"],
        ["map", "a.laz", "--out", "NAME"],
        ["map", "a.laz", "--out", "o", "--set", "model=NAME"],
        ["map", "a.laz", "--out", "o", "--set", "scratch=x/NAME/y"],
        ["info", "NAME"],
        ["scan", "NAME", "--out", "o"],
        ["evaluate", "survey", "NAME", "--out", "o"],
        ["calibrate", "--out", "NAME"],
        ["train", "textures", "--out", "NAME"],
        ["demo", "--out", "NAME"],
    ],
)
def test_names_that_no_file_can_have_are_refused(tmp_path, monkeypatch, name, words):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, [word.replace("NAME", name) for word in words])
    assert result.exit_code == 2, (result.output, result.exception)
    assert "NUL" in result.stderr or "bytes" in result.stderr
    assert list(tmp_path.iterdir()) == []
