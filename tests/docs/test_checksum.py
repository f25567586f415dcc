"""The ways that the documentation shows to compute the checksum of an input."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bumpymap.core import hash_file

B3SUM = """
import sys
from blake3 import blake3
found = blake3(sys.stdin.buffer.read())
sys.stdout.buffer.write(found.digest() if "--raw" in sys.argv else f"{found.hexdigest()}  -\\n".encode())
"""
"""What the program b3sum does with its standard input."""
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


@pytest.fixture(params=["program", "package"])
def b3sum(request, tmp_path):
    """Path of the program, and of what stands in for it where it is not installed."""
    if request.param == "program":
        return shutil.which("b3sum") or pytest.skip("needs b3sum")
    (tmp_path / "b3sum.py").write_text(B3SUM, encoding="utf-8")
    return f"{shlex.quote(sys.executable)} {shlex.quote(str(tmp_path / 'b3sum.py'))}"


@pytest.mark.skipif(not shutil.which("split"), reason="needs GNU coreutils")
def test_in_a_shell(survey, b3sum):
    command = re.search(r"^```\n(split .*?)^```$", SECTION, re.MULTILINE | re.DOTALL)[1].replace("FILE", str(survey))
    command = re.sub(r"\bb3sum\b", lambda _: b3sum, command)
    found = subprocess.run(command, shell=True, check=True, capture_output=True, text=True).stdout  # noqa: S602 (our own page)
    assert f"blake3-1MiB:{found.split()[0]}" == hash_file(survey)
