"""The paper's tables beside ours, and drives over a survey held against its map: what scripts of tests/tools print."""

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from made_drives import churned_field, write_bin

import bumpymap

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("without_views")]

ROOT = Path(__file__).resolve().parents[2]
QUARRY = ROOT / "sample_data" / "quarry.laz"
RULES = {"flat": ([2], [0, 3]), "low_noise": ([0.5, 2.5], [0, 1, 3]), "noise_sin": ([0.5, 1, 2.5], [0, 1, 2, 3])}
RULES["high_noise"] = ([1.5, 2], [1, 2, 3])
"""The paper's table: texture -> limits of the raw z range [m], and the classes between them."""


def rows_of(text, first):
    """The cells of rows of tables whose first cell is ``first``."""
    lines = [re.split(r" *\| *", line.strip("| ")) for line in text.splitlines() if line.startswith("|")]
    return [cells[1:] for cells in lines if cells[0] == first]


@pytest.mark.later
def test_tables_are_those_of_the_rules_and_the_papers_stand_beside_them(tmp_path, monkeypatch, capsys):
    write_bin(tmp_path / "0.bin", churned_field(1))
    monkeypatch.syspath_prepend(ROOT / "tests" / "tools")
    monkeypatch.setattr(sys, "argv", ["tables.py", str(QUARRY), "--scans", str(tmp_path / "0.bin")])
    runpy.run_path(str(ROOT / "tests" / "tools" / "tables.py"), run_name="__main__")
    text = capsys.readouterr().out

    tiles = bumpymap.map_survey(QUARRY, compat="paper").tiles()  # textures and measures; the rule is above
    tall = (tiles["z_max"] - tiles["z_min"]).to_numpy()
    full = (tiles["texture"].notna() & (tiles["coverage"] >= 0.7)).to_numpy()
    class_id = np.full(len(tiles), 3)
    for form, (limits, classes) in RULES.items():
        own = full & (tiles["texture"] == form).to_numpy()
        class_id[own] = np.array(classes)[np.digitize(tall[own], limits)]
    rows = rows_of(text, "compat=paper")
    assert [int(cells[1]) for cells in rows] == [np.count_nonzero(class_id == number) for number in range(4)]
    for number, cells in enumerate(rows):
        means = [float(tiles[name][class_id == number].mean()) for name in ("z_variance", "ransac_residual")]
        assert [float(cells[4]), float(cells[6])] == pytest.approx(means, rel=0.01)

    assert [cells[4] for cells in rows_of(text, "paper, first site")] == ["0.0039", "0.0329", "0.0952", "36.1"]
    assert rows_of(text, "paper: heightmap method") == [["12.257", "0.084"]]
    assert 0 < float(rows_of(text, "bumpymap: all")[0][0]) < 12
    sectors = {method: sum(int(cells[1]) for cells in rows_of(text, method)) for method in ("filter", "learned")}
    assert sectors["filter"] == sectors["learned"] > 100
    assert "are not on record" in text
    assert "RELLIS-3D, which this project does not have" in text


@pytest.mark.later
def test_patches_of_a_survey_are_driven_and_compared(tmp_path):
    pytest.importorskip("dartpy")
    out, survey = tmp_path / "report.json", ROOT / "sample_data" / "quarry_part.ply"
    words = [ROOT / "tests" / "tools" / "driven.py", survey, "--patches", 4, "--drives", 2, "--out", out]
    said = subprocess.run([sys.executable, *map(str, words)], capture_output=True, text=True, check=True).stdout
    assert "| `ride` |" in said
    assert "4 patches, " in said
    patches = json.loads(out.read_text())["patches"]
    assert len(patches["driven"]["c_r"]) == len(patches["verdicts"]["ride"]["c_r"]) == 4
    assert min(patches["driven"]["c_r"]) > 0
