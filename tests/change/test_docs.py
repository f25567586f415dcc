"""The page about comparisons says what the code writes."""

import re
from pathlib import Path

import numpy as np
from route_maps import write_folder
from survey_pairs import survey

from bumpymap.change import DiffConfig, find_changes
from bumpymap.change.pipeline import CHANGE_FILES
from bumpymap.core import CHANGE_KINDS

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "pages" / "diff.md").read_text(encoding="utf-8")


def rows(title):
    """The first cells of the table with this first title."""
    (table,) = re.findall(rf"(?m)^\| {title} \|.*\n\|[-| ]*\n((?:\|.*\n)+)", PAGE)
    return [re.findall(r"`([^`]+)`", line.split("|")[1]) for line in table.splitlines()]


def test_files_and_bands_are_those_of_the_code():
    assert [name for (name,) in rows("file")] == [*CHANGE_FILES.names]
    bands = [name for names in rows("band") for name in names]
    assert bands == ["d_c_r", "z_c_r", "d_height", "z_height", "z_shape", "changed"]
    for number in range(len(CHANGE_KINDS)):
        assert re.search(rf"\| `changed` .*\b{number} ", PAGE)


def test_every_property_is_described(tmp_path):
    folders = [write_folder(tmp_path / str(rut), survey(1 + (rut > 0), rut=rut)) for rut in (0.0, 0.3)]
    result = find_changes(DiffConfig(*folders))
    told = set(re.findall(r"`([a-z0-9_]+)`", PAGE.split("Properties of a change")[1].split("## ")[0]))
    names = set(result.field.regions[0]) - {"d_height_lowest", "d_height_highest", "z_height", "z_shape", "z_c_r"}
    assert names == told - {"z_"}


def test_defaults_are_told():
    config = DiffConfig(Path("a"), Path("b"))
    assert f"on average ({config.fdr:g})" in PAGE
    assert f"left out ({config.min_tiles})" in PAGE
    assert np.isclose(config.fdr, 0.05)
