"""Settings and JSON of anyone: as they were asked for, or one message says why not; sentences, shares and cells."""

import csv
import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import pytest
from hypothesis import given, strategies as st

from bumpymap.core.errors import UsageError, share_text, shares_text
from bumpymap.core.files import Each, Nullable, Number, parse_json, shape_fault, write_csv
from bumpymap.core.settings import Setting, check_settings, read_settings_file, read_toml, settings_of_call

Colour = Literal["red", "blue"]


@dataclass(frozen=True, slots=True)
class Inner:
    number: float = 1.0
    corners: tuple[float, float] = (0.0, 1.0)
    counts: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Outer:
    places: tuple[Path, ...] = ()
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


def read(tmp_path, content, owner=Outer):
    file = tmp_path / "a.toml"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_settings_file(file, owner) if owner else read_toml(file, "settings", UsageError)


EVERY = """
text = 'é "a"'
count = -9223372036854775808
maybe = 9223372036854775807
yes = true
colour = "blue"
other = "red"
colours = ["red", "blue"]
places = ["a", "/b"]
files = ["e", "f/g"]
file = "../h"
[inner]
number = 2
corners = [-1e-300, 1.5]
counts = [3, -4]
"""


def test_what_is_written_comes_back_and_paths_start_at_the_folder_of_the_file(tmp_path):
    assert read(tmp_path, EVERY) == {
        "text": 'é "a"',
        "count": -(2**63),
        "maybe": 2**63 - 1,
        "yes": True,
        "colour": "blue",
        "other": "red",
        "colours": ("red", "blue"),
        "places": (tmp_path / "a", Path("/b")),
        "files": (tmp_path / "e", tmp_path / "f" / "g"),
        "file": tmp_path / "../h",
        "inner": Inner(2.0, (-1e-300, 1.5), (3, -4)),
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("none = 1\nnever = 2", r"a\.toml: unknown setting never, none; there are: places, files, file"),
        ("[inner]\nnone = 1", r"a\.toml: \[inner\]: unknown setting none; there are: number, corners, counts"),
        ("inner = 1", r"inner is 1; it must be a table, \[inner\], with number, corners, counts"),
        ('places = ["a", 7]', "value 2 of places is 7; it must be a string"),
        ("count = 1.0", r"count is 1\.0; it must be a whole number"),
        ("yes = 1", "yes is 1; it must be true or false"),
        ('colour = "green"', "colour is 'green'; it must be one of red, blue"),
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
    ("name", "value", "text", "allowed"),
    [
        ("side", 0.0, "0.0", "a number between 0 and 10 m"),
        ("count", 0, "0", "a whole number, at least 1, or there is nothing to do"),
        ("count", 1.5, "1.5", "a whole number, at least 1"),
        ("offset", math.inf, "inf", r"a finite number \(m\)"),
        ("offset", math.nan, "nan", r"a finite number \(m\)"),
        ("speeds", (1.0, 9.5), "[1.0, 9.5]", "a list of numbers from 0.5 to 9 m/s"),
        ("width", 6, "6", "one of 4, 5"),
    ],
)
def test_one_declaration_checks_objects_files_and_calls(tmp_path, name, value, text, allowed):
    for make in (
        lambda: Job(**{name: value}),
        lambda: read(tmp_path, f"{name} = {text}\n", Job),
        lambda: settings_of_call({name: value}, Job, "call"),
    ):
        with pytest.raises(UsageError, match=f"{name}.* is .*; it must be {allowed}"):
            make()


# --- TOML that no settings can be read from ---
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"x = 1\n" * 50_000, r"it has more than 16 kB"),
        (b"x = " + b"[" * 5000, r"nested too deep"),
        (b'\\"' * 5_000, r"Invalid"),
        (b"x = 1\0", r"invalid|Invalid|Expected"),
        (b"x = '\xff'", r"not UTF-8 text at byte 5; save it as UTF-8"),
        ("x = 1".encode("utf-16"), r"not UTF-8 text at byte 0"),
        (b"x = " + b"9" * 5000, r"cannot read settings"),
        (b"x = 1\nx = 2", r"Cannot overwrite a value"),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path, content, message):
    with pytest.raises(UsageError, match=message) as caught:
        read(tmp_path, content, None)
    assert str(caught.value).startswith(f"cannot read settings from {tmp_path / 'a.toml'}: ")
    assert len(str(caught.value)) < 1000


def test_a_mark_of_byte_order_is_skipped(tmp_path):
    assert read(tmp_path, b"\xef\xbb\xbfa = 1", None) == {"a": 1}


def test_only_regular_files_are_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    for path in (tmp_path / "pipe.toml", Path("/dev/zero"), tmp_path, tmp_path / "none.toml", Path("a\0b")):
        with pytest.raises(UsageError, match=r"cannot read settings from .*: (it is a pipe|Is a|No such|embedded)"):
            read_toml(path, "settings", UsageError)


# ---- text for people and JSON of others ----


@given(st.lists(st.integers(20, 100), min_size=1, max_size=5), st.integers(0, 2))
def test_shares_of_a_whole_make_100_percent(counts, decimals):
    told = [float(text) for text in shares_text(counts, (), decimals, "")]
    assert sum(told) == pytest.approx(100.0, abs=1e-6)
    for share, count in zip(told, counts, strict=True):
        assert abs(share - 100 * count / sum(counts)) < 10.0**-decimals + 1e-6


@pytest.mark.parametrize("counts", [(1, 1, 1), (1255, 785, 745), (125, 375, 500), (495, 495, 10), (0, 0, 7)])
def test_a_share_that_is_told_elsewhere_is_the_same_everywhere(counts):
    told = shares_text(counts, (0, 1))
    assert told[:2] == [share_text(count / sum(counts)) for count in counts[:2]]
    assert sum(int(text.strip("%")) for text in told) == 100


def test_small_shares_are_not_rounded_to_nothing_nor_large_ones_to_all():
    assert shares_text([1, 9999], (), 1) == ["under 0.1%", "over 99.9%"]
    assert shares_text([0, 5]) == ["0%", "100%"]


@pytest.mark.parametrize(
    ("value", "cell"),
    [
        ("=cmd|' /C calc'!A0", "'=cmd|' /C calc'!A0"),
        ("+1 north", "'+1 north"),
        (" -x", "' -x"),
        ("\t=1", "\\t=1"),
        ("\uff1d1", "'\uff1d1"),
        ("a\x1b[31m\u202eb\nc\udce9", "a\\x1b[31m\\u202eb\\nc\\xe9"),
        ("quarry, é 道 = 'a'", "quarry, é 道 = 'a'"),
        ("-1.50", "-1.50"),
        (-1.5, "-1.5"),
        (True, "true"),
        (None, ""),
        ("", ""),
    ],
)
def test_cells_are_text_or_numbers_and_no_formulas(tmp_path, value, cell):
    write_csv(tmp_path / "a.csv", ["one", "two"], [[value, 1]])
    with (tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
        assert list(csv.reader(file)) == [["one", "two"], [cell, "1"]]


SHAPE = {"a": Number(0, 9, whole=True), "b?": [str], "c?": (Nullable(Number()),) * 2, "d?": Each({"e": bool})}


@pytest.mark.parametrize(
    ("value", "fault"),
    [
        ({"a": 9, "more": None}, ""),
        ({"a": 1, "b": [], "c": [None, 0.5], "d": {"x": {"e": True}}}, ""),
        ({}, "it is "),
        ({"a": True}, "a is "),
        ({"a": 1, "b": ["x", 2]}, "b.1 is "),
        ({"a": 1, "c": [1, float("nan")]}, "c.1 is "),
        ({"a": 1, "d": {"x": {"e": 1}}}, "d.x.e is "),
    ],
)
def test_the_first_fault_of_a_shape_is_named(value, fault):
    found = shape_fault(value, SHAPE)
    assert found.startswith(fault)
    assert bool(found) == bool(fault)


@pytest.mark.parametrize("depth", [51, 200_000])
@pytest.mark.parametrize(("opening", "closing"), ["[]", ('{"a":', "}")])
def test_what_is_deep_is_refused(depth, opening, closing):
    with pytest.raises(ValueError, match="more than 50 deep"):
        parse_json(opening * depth + "1" + closing * depth)
