"""What batch.md says of tables, summaries and other tools is so."""

import os
import re
import shutil
import subprocess
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


@pytest.mark.slow
def test_the_makefile_makes_what_is_missing_and_goes_on_after_a_failure(tmp_path):
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    (text,) = re.findall(r"```make\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "Makefile").write_text(text)
    (tmp_path / "flights").mkdir()
    for name in ("a", "bad", "c"):
        (tmp_path / "flights" / f"{name}.laz").touch()
    program = tmp_path / "bin" / "bumpymap"
    program.parent.mkdir()
    program.write_text(
        '#!/bin/sh\necho "$@" >> log\ncase $2 in *bad*) exit 3;; esac\nmkdir -p "$4" && touch "$4/run.json"\n'
    )
    program.chmod(0o755)
    env = os.environ | {"PATH": f"{program.parent}:{os.environ['PATH']}"}
    for _ in range(2):
        done = subprocess.run(["make", "-j", "2", "-k"], cwd=tmp_path, env=env, capture_output=True, check=False)
        assert done.returncode == 2
    given = sorted((tmp_path / "log").read_text().splitlines())
    assert [line.split()[1] for line in given] == [
        "flights/a.laz",
        "flights/bad.laz",
        "flights/bad.laz",
        "flights/c.laz",
    ]
    assert given[0] == "map flights/a.laz --out maps/a --threads 1 --quiet"
