"""The checksum of an input, as the page of files computes it."""

import re
from pathlib import Path

from bumpymap.readers import hash_survey

PAGE = Path(__file__).resolve().parents[2] / "docs" / "pages" / "files.md"


def test_the_python_of_the_page(tmp_path):
    survey = tmp_path / "survey.las"
    survey.write_bytes(bytes(range(251)) * 10_000)
    section, names = PAGE.read_text(encoding="utf-8").partition("### The checksum of an input")[2], {}
    exec(re.search(r"^```python\n(.*?)^```$", section, re.MULTILINE | re.DOTALL)[1], names)  # noqa: S102 (our own page)
    assert names["checksum"](survey) == hash_survey(survey)
