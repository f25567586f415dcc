"""The Python of the API page runs, block after block, as it stands: the notebook at its begin, then the calls."""

import re
from pathlib import Path

import made_drives
import pytest

import bumpymap

matplotlib = pytest.importorskip("matplotlib")

pytestmark = pytest.mark.slow
matplotlib.use("Agg")

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "pages" / "api.md"
TEXT = PAGE.read_text(encoding="utf-8")
CALLS = TEXT.index("\n## Map a survey\n")
_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def site_layers(tmp_path_factory):
    return bumpymap.map_survey(ROOT / "sample_data" / "quarry.laz", tmp_path_factory.mktemp("site") / "site_layers")


@pytest.mark.parametrize("part", ["notebook", "calls"])
def test_the_python_of_the_page_runs(part, site_layers, tmp_path, monkeypatch):
    (tmp_path / "sample_data").symlink_to(ROOT / "sample_data")
    for name in ("site_layers", "may_layers", "june_layers"):
        (tmp_path / name).symlink_to(site_layers.folder)
    write_drives(tmp_path)
    monkeypatch.chdir(tmp_path)
    blocks = [block for block in _BLOCK.finditer(TEXT) if (block.start() < CALLS) == (part == "notebook")]
    assert blocks
    names = {}
    for block in blocks:
        line = TEXT.count("\n", 0, block.start()) + 1
        exec(compile("\n" * line + block[1], str(PAGE), "exec"), names)  # noqa: S102 (our own page)
    if part == "notebook":
        check_notebook(names, tmp_path)


def write_drives(folder):
    """Write a drive of 40 m over the survey as one file, and as one for each sensor."""
    log, _, _ = made_drives.log_of(made_drives.MadeDrive(seconds=60.0, turning=0.0))
    names = ("monday.csv", "imu.csv", "gnss.csv")
    whole = made_drives.write_table(folder / names[0], log, (512350.0, 5403260.0))
    rows = [line.split(",") for line in whole.read_text("utf-8").splitlines()]
    for name, columns in (("imu.csv", slice(0, 7)), ("gnss.csv", slice(7, None))):
        lines = [",".join([row[0], *row[columns][columns.start == 0 :]]) for row in rows]
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


def check_notebook(names, folder):
    """The numbers that the page speaks of, and the picture."""
    assert repr(names["layers"]) in TEXT
    assert list(names["statistics"].index) == ["smooth", "fair", "rough", "very rough"]
    assert names["statistics"]["c_r"].is_monotonic_increasing
    dearest_shown = names["cheapest"]["cost"].max()
    assert (names["tiles"]["cost"] < dearest_shown).sum() < 5
    assert 0 < names["passable"].area.sum() < names["regions"].area.sum()
    assert set(names["scan"].sector_class.tolist()) > {0, 255}
    picture = matplotlib.image.imread(folder / "notebook.png")
    assert picture.shape[:2] == (400, 1200)
    assert len({tuple(pixel) for pixel in picture[::4, ::4].reshape(-1, 4).tolist()}) > 50


def test_every_public_name_is_on_the_page():
    assert set(re.findall(r"^::: bumpymap\.(\w+)$", TEXT, re.MULTILINE)) == set(bumpymap.__all__) - {"__version__"}
