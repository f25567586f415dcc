"""TOML files come from anyone: whatever stands in one, or is no file at all, one message says so, soon."""

import os
import re
import tomllib
from pathlib import Path

import pytest
from hypothesis import assume, given, strategies as st

from bumpymap.core.errors import UsageError
from bumpymap.core.settings import read_toml


def read(tmp_path, content):
    file = tmp_path / "a.toml"
    file.write_bytes(content)
    return read_toml(file, "settings", UsageError)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"a." * 5000 + b"a = 1", r"the key in line 1 has more than 16 parts"),
        (b"x = 1\n[" + b" a . " * 4999 + b"a]", r"the key in line 2 has more than 16 parts"),
        (b"x = '''\n\n''' # a.b\n" + b"'a.b'." * 20 + b"c = 1", r"the key in line 4 has more than 16 parts"),
        (b"x = [{" + b'"a".' * 20 + b"c = 1}]", r"the key in line 1 has more than 16 parts"),
        (b"x = 1\n" * 50_000, r"it has more than 256 kB"),
        (b"x = " + b"[" * 5000, r"nested too deep"),
        (b"x = " + b"{a=" * 5000, r"nested too deep"),
        (b'\\"' * 100_000, r"Invalid"),
        (b"x = 1\0", r"invalid|Invalid|Expected"),
        (b"x = '\xff'", r"not UTF-8 text at byte 5; save it as UTF-8"),
        ("x = 1".encode("utf-16"), r"not UTF-8 text at byte 0"),
        (b"x = " + b"9" * 5000, r"cannot read settings"),
        (b"x = 1\nx = 2", r"Cannot overwrite a value"),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path, content, message):
    with pytest.raises(UsageError, match=message) as caught:
        read(tmp_path, content)
    assert str(caught.value).startswith(f"cannot read settings from {tmp_path / 'a.toml'}: ")
    assert len(str(caught.value)) < 1000


def test_dots_in_texts_and_comments_are_no_parts(tmp_path):
    dots = b"1. " * 15 + b"." * 100
    content = b"a = '" + dots + b'\'\nb = "\\"' + dots + b'" # ' + dots + b"\nc = '''\n'" + dots + b"''''\n"
    assert read(tmp_path, content + b"d = [1.5,2.5," + b"3.5," * 100 + b"]")["c"].startswith("'1.")


def test_a_mark_of_byte_order_is_skipped(tmp_path):
    assert read(tmp_path, b"\xef\xbb\xbfa = 1") == {"a": 1}


def test_only_regular_files_are_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    for path in (tmp_path / "pipe.toml", Path("/dev/zero"), tmp_path):
        with pytest.raises(UsageError, match="it is not a file"):
            read_toml(path, "settings", UsageError)
    for path in (tmp_path / "none.toml", Path("a\0b")):
        with pytest.raises(UsageError, match="there is no such file"):
            read_toml(path, "settings", UsageError)


@given(st.text(st.sampled_from("a.=[]{}'\"\\#,\n 1"), max_size=60))
def test_the_bound_refuses_nothing_that_has_few_dots(tmp_path_factory, text):
    assume(text.count(".") < 16)
    folder = tmp_path_factory.mktemp("toml")
    try:
        wanted = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        with pytest.raises(UsageError, match=re.escape(str(error))):
            read(folder, text.encode())
    else:
        assert read(folder, text.encode()) == wanted
