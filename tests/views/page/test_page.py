"""Templates: texts are escaped, a name that is missing is an error, and compiled ones are kept where that can be."""

import sys

import pytest

from bumpymap.layers import SurveyRow
from bumpymap.views.page import page
from bumpymap.views.page.batch_page import index_page

HOSTILE = "<b>'&\udce9\x1b[31m\u202e"


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """The folder that compiled templates are kept in, and an engine that has none in memory."""
    monkeypatch.setattr(sys, "pycache_prefix", str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    page._engine.cache_clear()
    yield tmp_path
    page._engine.cache_clear()


def test_compiled_templates_are_kept_and_give_the_same_page(kept):
    rows = [SurveyRow(HOSTILE, "failed", HOSTILE)]
    first = index_page(rows, {}, [HOSTILE], HOSTILE, HOSTILE)
    assert not [sign for sign in ("<b>", "\x1b", "\u202e") if sign in first]
    assert first.count(r"\x1b[31m\u202e") >= 4
    found = sorted(kept.rglob("*.cache"))
    assert len(found) == 2  # the page and its frame
    times = [file.stat().st_mtime_ns for file in found]
    page._engine.cache_clear()
    assert index_page(rows, {}, [HOSTILE], HOSTILE, HOSTILE) == first
    assert [file.stat().st_mtime_ns for file in found] == times
    page.compile_pages()
    names = [*page._HERE.parent.glob("*/templates/*.*ml")]
    assert len(list(kept.rglob("*.cache"))) == len(names)


def test_a_page_is_made_where_nothing_can_be_kept(kept, monkeypatch):
    (kept / "file").write_text("no folder")
    monkeypatch.setattr(sys, "pycache_prefix", str(kept / "file"))
    assert "1 failed" in index_page([SurveyRow("a", "failed")], {}, [], "night")


def test_what_a_record_lacks_is_no_empty_text():
    with pytest.raises(LookupError, match="'title' is undefined"):
        page.render_page("batch.html", note="", links=[], rows=[], unknown_colour=(0, 0, 0))
