"""Text for people: tables that a spreadsheet may open, and numbers with their nouns."""

import csv
from pathlib import Path

import numpy as np
import pytest

from bumpymap.core import write_csv

HOUSE = Path(__file__).resolve().parents[2] / "bumpymap"


@pytest.mark.parametrize(
    ("value", "cell"),
    [
        ("=cmd|' /C calc'!A0", "'=cmd|' /C calc'!A0"),
        ("@SUM(1)", "'@SUM(1)"),
        ("+1 north", "'+1 north"),
        (" -x", "' -x"),
        ("\t=1", "\\t=1"),
        ("\uff1d1", "'\uff1d1"),
        ("a\x1b[31m\u202eb\nc\udce9", "a\\x1b[31m\\u202eb\\nc\\xe9"),
        ("quarry, é 道 = 'a'", "quarry, é 道 = 'a'"),
        ("-1.50", "-1.50"),
        (-1.5, "-1.5"),
        (np.float64(-2.5), "-2.5"),
        (-3, "-3"),
        (True, "true"),
        (None, ""),
        ("", ""),
    ],
)
def test_cells_are_text_or_numbers_and_no_formulas(tmp_path, value, cell):
    write_csv(tmp_path / "a.csv", ["one", "two"], [[value, 1]])
    with (tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
        assert list(csv.reader(file)) == [["one", "two"], [cell, "1"]]


def test_every_table_is_written_so():
    for file in HOUSE.rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        assert file.match("core/files.py") or not ("csv.writer" in text or "csv.DictWriter" in text), file
