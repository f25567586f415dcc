"""The pages about files: snippets run, tables say what the code does."""

import re
from pathlib import Path

import pytest

from bumpymap.core.types import BARRED_TEXT, CLASS_NAMES, OBJECT_NAMES, REASON_TEXT, CostTable, Reason
from bumpymap.layers import write_products
from bumpymap.layers.colours import CLASS_COLOURS
from bumpymap.layers.placement import MAX_PIXELS, MAX_TILES
from bumpymap.layers.products import VIEW_NAMES
from bumpymap.views import write_map_views

pytestmark = pytest.mark.slow

PAGES = Path(__file__).resolve().parents[2] / "docs" / "pages"
WITH_PYTHON = ("files.md", "gis.md")


@pytest.fixture(name="page", scope="module")
def page_fixture():
    return (PAGES / "files.md").read_text(encoding="utf-8")


@pytest.fixture(name="layers", scope="module")
def layers_fixture(tmp_path_factory, cost_map):
    folder = tmp_path_factory.mktemp("docs") / "OUT"
    folder.mkdir()
    write_products(CostTable.of(cost_map), folder, views=write_map_views, local=False, manifest={})
    return folder


def snippets():
    """Python of the pages, by page and number."""
    found = {
        page: re.findall(r"```python\n(.*?)```", (PAGES / page).read_text("utf-8"), re.DOTALL) for page in WITH_PYTHON
    }
    return {f"{page}, snippet {number}": text for page in found for number, text in enumerate(found[page])}


@pytest.mark.parametrize("name", snippets())
def test_snippet_runs(layers, monkeypatch, name):
    monkeypatch.chdir(layers.parent)
    names = {}
    exec(compile(snippets()[name], name, "exec"), names)  # noqa: S102 (our own page)
    assert any(not name.startswith("__") for name in names)


def test_tables_say_what_the_code_writes(page):
    for value, name in enumerate(CLASS_NAMES):
        colour = "#{:02x}{:02x}{:02x}".format(*CLASS_COLOURS[value])
        assert f"| {value} | {name} | `{colour}` |" in page
    for reason in Reason:
        assert f"| {reason.value} | {REASON_TEXT[reason]} |" in page
    for code, text in BARRED_TEXT.items():
        assert f"| {code.value} | {text} |" in page
    for value, text in enumerate(OBJECT_NAMES):
        assert f"| {value} | {text} |" in page
    assert f"{MAX_TILES:,} tiles" in page
    assert f"{MAX_PIXELS:,} heightmap pixels" in page


def test_the_page_about_gis_names_each_style_and_layer():
    rows = re.findall(r"^\| `([\w/]+\.qml)` \| (.+?) \|", (PAGES / "gis.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert {style for style, _ in rows} >= {name for name in VIEW_NAMES if name.endswith(".qml")}
    assert all(
        Path(layer).stem == Path(style).stem for style, layers in rows for layer in re.findall("`(.+?)`", layers)
    )
