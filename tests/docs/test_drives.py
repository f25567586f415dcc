"""The scripts of docs/drives: what they measure on drives whose truth is known, and on real ones."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "pages" / "ride-cost.md"


def script(name):
    spec = importlib.util.spec_from_file_location(f"docs_drives_{name}", ROOT / "docs" / "drives" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look for their module
    spec.loader.exec_module(module)
    return module


boreal = script("borealtc")


def test_the_surfaces_that_pages_show_are_those_of_the_whole_set():
    known = json.loads((ROOT / "bumpymap" / "views" / "page" / "data" / "surfaces.json").read_text(encoding="utf-8"))
    assert {one["name"]: one["c_r"] for one in known["surfaces"]} == boreal.WHOLE_SET
    text = PAGE.read_text(encoding="utf-8")
    assert all(f"{c_r:.3f}" in text for c_r in boreal.WHOLE_SET.values())


@pytest.mark.realdata
def test_the_real_drives_give_the_figures_of_the_page(shared_data, capsys):
    boreal.main(shared_data / "drives" / "borealtc")
    printed, page = capsys.readouterr().out, PAGE.read_text(encoding="utf-8")
    assert len([line for line in printed.splitlines() if line.startswith("|") and "---" not in line]) == 44
    (table,) = (part for part in printed.split("\n\n") if part.startswith("| surface | way, m |"))
    assert len(table.splitlines()) == 7  # head, line, 5 surfaces
    assert table in page


@pytest.mark.realdata
def test_three_of_five_surfaces_are_within_a_tenth_of_the_whole_set(shared_data):
    """Of ice only slow drives are here, of snow only two drives of nine metres and more."""
    found = {
        name: boreal.measure_surface(boreal.read_boreal(shared_data / "drives" / "borealtc" / folder))
        for name, folder in boreal.FOLDERS.items()
    }
    ratio = {name: c_r / boreal.WHOLE_SET[name] for name, (c_r, _, _) in found.items()}
    for name in ("asphalt", "indoor floor", "silty loam"):
        assert ratio[name] == pytest.approx(1.0, abs=0.1)
    low, high = found["snow"][1:]
    assert low < boreal.WHOLE_SET["snow"] < high
    assert ratio["ice"] < 1.5
