"""The ways that the documentation shows to compute the checksum of an input."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from bumpymap.core import hash_file

PAGE = Path(__file__).resolve().parents[2] / "docs" / "pages" / "files.md"
SECTION = PAGE.read_text(encoding="utf-8").partition("### The checksum of an input")[2]


@pytest.fixture
def survey(tmp_path):
    path = tmp_path / "survey.las"
    path.write_bytes(bytes(range(251)) * 10_000)
    return path


def test_in_python(survey):
    names = {}
    exec(re.search(r"^```python\n(.*?)^```$", SECTION, re.MULTILINE | re.DOTALL)[1], names)  # noqa: S102 (our own page)
    assert names["checksum"](survey) == hash_file(survey)


@pytest.mark.skipif(not (shutil.which("split") and shutil.which("xxd")), reason="needs GNU coreutils and xxd")
def test_in_a_shell(survey):
    command = re.search(r"^```\n(split .*?)^```$", SECTION, re.MULTILINE | re.DOTALL)[1].replace("FILE", str(survey))
    found = subprocess.run(command, shell=True, check=True, capture_output=True, text=True).stdout  # noqa: S602 (our own page)
    assert f"sha256-1MiB:{found.split()[0]}" == hash_file(survey)
