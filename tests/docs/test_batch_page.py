"""What batch.md says of tables, summaries and other tools is so."""

import re
from dataclasses import fields
from pathlib import Path

import pytest

from bumpymap.core import UsageError
from bumpymap.layers import SurveyRow
from bumpymap.survey.batch.source import read_table

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "pages" / "batch.md").read_text(encoding="utf-8")


def test_the_columns_of_the_summary_are_described_in_their_order():
    rows = PAGE.split("| column | meaning |")[1].split("\n\n")[0].splitlines()
    described = [name for row in rows if row.startswith("| `") for name in re.findall(r"`(\w+)`", row.split("|")[1])]
    assert described == [column.name for column in fields(SurveyRow)]


def test_the_columns_of_a_table_are_described_and_the_example_is_one(tmp_path):
    (named,) = re.findall(r"The\s+columns are (.*?)\.\s", PAGE, re.DOTALL)
    columns = re.findall(r"`(\w+)`", named)
    with pytest.raises(UsageError) as caught:
        read_table("survey,nonsense", "a.csv", tmp_path)
    assert sorted(str(caught.value).split("there are: ")[1].split(", ")) == sorted(["survey", "name", *columns])
    (tmp_path / "2026-05-03").mkdir()
    for name in ("north", "south"):
        (tmp_path / "2026-05-03" / f"{name}.laz").touch()
    (example,) = re.findall(r"```text\n(survey,.*?)```", PAGE, re.DOTALL)
    north, south = read_table(example, "a.csv", tmp_path)
    assert north == (tmp_path / "2026-05-03" / "north.laz", "north", {"crs": "EPSG:32614"})
    assert south[2] == {"crs": "EPSG:32615", "ground": "csf", "vehicle": "car"}
