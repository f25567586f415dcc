"""Settings from TOML: what is written comes back as the type that was asked for, or one message says what is wrong."""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import pytest
from hypothesis import given, settings, strategies as st

from bumpymap.core.errors import UsageError
from bumpymap.core.settings import Setting, check_settings, parse_record, read_settings_file, settings_of_call

Colour = Literal["red", "blue"]


@dataclass(frozen=True, slots=True)
class Inner:
    number: float = 1.0
    corners: tuple[float, float] = (0.0, 1.0)
    counts: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Outer:
    places: tuple[Path | str, ...] = ()
    files: tuple[Path, ...] = ()
    file: Path | None = None
    text: str | None = None
    count: int = 0
    maybe: int | None = None
    yes: bool = False
    colour: Colour = "red"
    other: Colour | None = None
    colours: tuple[Colour, ...] = ()
    inner: Inner = field(default_factory=Inner)


class AtMostOne:
    """A rule of numbers."""

    allowed = "at most 1"

    def fault(self, value):
        return "" if value <= 1 else f"it must be {self.allowed}"


@dataclass(frozen=True, slots=True)
class Ruled:
    share: Annotated[float, AtMostOne()]
    inner: Inner = field(default_factory=Inner)


def read(tmp_path, text):
    file = tmp_path / "a.toml"
    file.write_text(text, encoding="utf-8")
    return read_settings_file(file, Outer)


def toml(value):
    """Return a TOML value. JSON's texts, lists and booleans are TOML's too."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml, value))}]"
    return repr(value) if isinstance(value, float) else json.dumps(value)


finite = st.floats(allow_nan=False, allow_infinity=False)
whole = st.integers(-(2**63), 2**63 - 1)
words = st.text(st.characters(codec="ascii", categories=("L", "N", "P", "Zs")), min_size=1)


@settings(max_examples=30)
@given(
    plain=st.fixed_dictionaries(
        {},
        optional={
            "text": words,
            "count": whole,
            "maybe": whole,
            "yes": st.booleans(),
            "colour": st.sampled_from(["red", "blue"]),
            "other": st.sampled_from(["red", "blue"]),
            "colours": st.lists(st.sampled_from(["red", "blue"])).map(tuple),
        },
    ),
    inner=st.fixed_dictionaries(
        {},
        optional={
            "number": finite,
            "corners": st.tuples(finite, finite),
            "counts": st.lists(whole).map(tuple),
        },
    ),
)
def test_what_is_written_comes_back(tmp_path_factory, plain, inner):
    lines = [f"{name} = {toml(value)}" for name, value in plain.items()]
    lines += ["[inner]", *(f"{name} = {toml(value)}" for name, value in inner.items())]
    found = read(tmp_path_factory.getbasetemp(), "\n".join(lines))
    assert found == plain | {"inner": Inner(**inner)}
    assert Outer(**found) == Outer(**plain, inner=Inner(**inner))


def test_paths_start_at_the_folder_of_the_file_and_urls_stay_texts(tmp_path):
    settings = read(tmp_path, 'places = ["a", "/b", "s3://c/d"]\nfiles = ["e", "f/g"]\nfile = "../h"')
    assert settings == {
        "places": (tmp_path / "a", Path("/b"), "s3://c/d"),
        "files": (tmp_path / "e", tmp_path / "f" / "g"),
        "file": tmp_path / "../h",
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("none = 1\nnever = 2", r"a\.toml: unknown setting never, none; there are: places, files, file"),
        ("[inner]\nnone = 1", r"a\.toml: \[inner\]: unknown setting none; there are: number, corners, counts"),
        ("inner = 1", r"inner is 1; it must be a table, \[inner\], with number, corners, counts"),
        ('places = "a"', "places is 'a'; it must be a list of strings"),
        ('places = ["a", 7]', "value 2 of places is 7; it must be a string"),
        ("file = 1", "file is 1; it must be a string"),
        ("text = true", "text is True; it must be a string"),
        ("count = 1.0", r"count is 1\.0; it must be a whole number"),
        ("count = true", "count is True; it must be a whole number"),
        ("maybe = false", "maybe is False; it must be a whole number"),
        ("yes = 1", "yes is 1; it must be true or false"),
        ('colour = "green"', "colour is 'green'; it must be one of red, blue"),
        ("other = [1]", r"other is \[1\]; it must be one of red, blue"),
        ('colours = ["red", "green"]', "value 2 of colours is 'green'; it must be one of red, blue"),
        ("[inner]\nnumber = true", r"inner\.number is True; it must be a number"),
        (f"[inner]\nnumber = 1{'0' * 400}", "it must be a number"),
        ("[inner]\ncorners = [1]", r"inner\.corners is \[1\]; it must be a list of 2 numbers"),
        ("[inner]\ncounts = [1, 2.5]", r"value 2 of inner\.counts is 2\.5; it must be a whole number"),
        ("count = ", "cannot read settings from .*a.toml"),
    ],
)
def test_what_is_wrong_is_said_with_what_is_allowed(tmp_path, text, message):
    with pytest.raises(UsageError, match=message):
        read(tmp_path, text)


def test_all_faults_are_said_at_once(tmp_path):
    with pytest.raises(UsageError) as caught:
        read(tmp_path, "none = 1\ncount = 1.5\nplaces = [1, 'a', 2]\n[inner]\nnumber = true\nlow = 1\n")
    first, *faults = caught.value.args
    assert first == f"{tmp_path / 'a.toml'}: 6 errors"
    assert [fault.split(";")[0] for fault in faults] == [
        "  unknown setting none",
        "  value 1 of places is 1",
        "  value 3 of places is 2",
        "  count is 1.5",
        "  [inner]: unknown setting low",
        "  inner.number is True",
    ]


def test_the_faults_of_a_hostile_file_are_said_in_short(tmp_path):
    with pytest.raises(UsageError) as caught:
        read(tmp_path, f"places = [{'1,' * 500}]")
    assert caught.value.args[0].endswith("a.toml: 500 errors")
    assert caught.value.args[-1] == "  and 460 more"
    assert len(caught.value.args) == 42


def test_rules_and_missing_fields(tmp_path):
    assert parse_record({"share": 1}, Ruled, tmp_path, complete=True) == ({"share": 1.0}, [])
    for record, fault in (
        ({}, "missing share: at most 1"),
        ({"share": 2}, "share is 2; it must be at most 1"),
        ({"share": "much"}, "share is 'much'; it must be at most 1"),
        ({"share": "?"}, "share is not filled in: at most 1"),
        ({"share": 1, "inner": {}}, ""),
        ([], "it holds []; it must hold a table with share, inner"),
    ):
        assert parse_record(record, Ruled, tmp_path, complete=True)[1] == ([fault] if fault else [])
    assert parse_record({}, Ruled, tmp_path) == ({}, [])


@dataclass(frozen=True, slots=True)
class Job:
    side: Annotated[float, Setting("Side of a tile", "M", 0.0, 10.0, "m", exclusive=True)] = 3.0
    count: Annotated[int, Setting("How many", "N", 1, why=", or there is nothing to do")] = 1
    offset: Annotated[float | None, Setting("Height", "M", unit="m")] = None
    speeds: Annotated[tuple[float, ...], Setting("Speeds", "LIST", 0.5, 9.0, "m/s")] = ()
    width: Annotated[Literal[4, 5], Setting("Columns", "N")] = 4

    def __post_init__(self):
        check_settings(self)


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("side", 0.0, "a number between 0 and 10 m"),
        ("side", 10.0, "a number between 0 and 10 m"),
        ("count", 0, "a whole number, at least 1, or there is nothing to do"),
        ("count", 1.5, "a whole number, at least 1"),
        ("count", True, "a whole number, at least 1"),
        ("offset", math.inf, r"a finite number \(m\)"),
        ("offset", math.nan, r"a finite number \(m\)"),
        ("speeds", (1.0, 9.5), "a list of numbers from 0.5 to 9 m/s"),
        ("width", 6, "one of 4, 5"),
    ],
)
def test_one_declaration_checks_objects_files_and_calls(tmp_path, name, value, allowed):
    text = toml(value) if isinstance(value, tuple | bool) else str(value)
    (tmp_path / "a.toml").write_text(f"{name} = {text}\n")
    for make in (
        lambda: Job(**{name: value}),
        lambda: read_settings_file(tmp_path / "a.toml", Job),
        lambda: settings_of_call({name: value}, Job, "call"),
    ):
        with pytest.raises(UsageError, match=f"{name}.* is .*; it must be {allowed}"):
            make()
