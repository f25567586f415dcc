"""The pages about files and styles: snippets run, tables and styles say what the code does."""

import re
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from bumpymap.core.types import BANDS, BARRED_TEXT, CLASS_NAMES, OBJECT_NAMES, REASON_TEXT, CostTable, Reason
from bumpymap.layers import (
    BARRED_COLOURS,
    CLASS_COLOURS,
    MAX_PIXELS,
    MAX_TILES,
    OBJECT_COLOURS,
    PRODUCT_NAMES,
    write_products,
)

pytestmark = pytest.mark.slow

PAGES = Path(__file__).resolve().parents[2] / "docs" / "pages"
STYLES = PAGES / "styles"
WITH_PYTHON = ("files.md", "gis.md")


@pytest.fixture(name="page", scope="module")
def page_fixture():
    return (PAGES / "files.md").read_text(encoding="utf-8")


@pytest.fixture(name="layers", scope="module")
def layers_fixture(tmp_path_factory, cost_map):
    folder = tmp_path_factory.mktemp("docs") / "OUT"
    folder.mkdir()
    write_products(CostTable.of(cost_map), folder, local=False, manifest={})
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


def test_every_file_has_a_snippet():
    text = "".join(snippets().values())
    assert {name for name in PRODUCT_NAMES if f"OUT/{name}" in text} >= set(PRODUCT_NAMES) - {"cost.geojson"}


def test_tables_say_what_the_code_writes(page):
    for number, band in enumerate(BANDS, start=1):
        assert re.search(rf"\| {number} \| `{band.name}` \| {re.escape(band.unit)} ?\| ", page)
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


def read_style(name):
    return ET.parse(STYLES / name).getroot()  # noqa: S314 (our own file)


def entries(style):
    found = read_style(style).iter("paletteEntry")
    return {
        int(entry.get("value")): (entry.get("label"), entry.get("color"), int(entry.get("alpha"))) for entry in found
    }


def test_styles_have_the_colours_and_names_of_the_classes():
    colours = {value: "#{:02x}{:02x}{:02x}".format(*CLASS_COLOURS[value]) for value in range(4)}
    assert entries("class.qml") == {value: (CLASS_NAMES[value], colours[value], 255) for value in range(4)}
    assert {value: label for value, (label, _, _) in entries("reason.qml").items()} == {
        reason.value: text for reason, text in REASON_TEXT.items()
    }
    for name, names, colours in (
        ("barred.qml", tuple(BARRED_TEXT.values()), BARRED_COLOURS),
        ("obstacle.qml", OBJECT_NAMES, OBJECT_COLOURS),
    ):
        expected = {
            value: (text, "#{:02x}{:02x}{:02x}".format(*colours[value]), colours[value][3])
            for value, text in enumerate(names)
        }
        assert entries(name) == expected
    root = read_style("cost.qml")
    assert {"class_name", "passable"} <= set(re.findall(r'"(\w+)"', root.find("renderer-v2").get("attr")))
    assert [category.get("value") for category in root.iter("category")] == [*CLASS_NAMES, "unknown", "not passable"]
    assert root.find("pipe/rasterrenderer").get("band") == "1"  # cost.tif takes its style from the same file
    for value in range(4):
        symbol = root.find(f".//symbol[@name='{value}']")
        assert symbol.find(".//prop[@k='color']").get("v") == ",".join(map(str, CLASS_COLOURS[value]))


def test_page_about_styles_names_each_of_them():
    text = (PAGES / "gis.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\(styles/(\w+\.qml)\)", text)) == {path.name for path in STYLES.iterdir()}
