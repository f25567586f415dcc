"""The scripts of docs/drives: what they measure on drives whose truth is known, and on real ones."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "pages" / "ride-cost.md"


def script(name):
    spec = importlib.util.spec_from_file_location(f"docs_drives_{name}", ROOT / "docs" / "drives" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look for their module
    spec.loader.exec_module(module)
    return module


boreal = script("borealtc")


def a_drive(speed, lugs_per_m=17.0, amplitude=0.02, noise=0.004, seconds=120.0):
    """Straight ahead at a speed that wanders, with a line of lugs, noise, and 5 s of standstill at its end."""
    rng = np.random.default_rng(4)
    time = np.arange(0, seconds, 0.01)
    pace = speed * (1 + 0.2 * np.sin(2 * np.pi * time / 20))
    pace[-500:] = 0.0
    way = np.cumsum(pace) / 100
    rate = amplitude * np.sin(2 * np.pi * lugs_per_m * way) * (pace > 0) + rng.normal(0, noise, len(time))
    felt = sosfiltfilt(butter(4, 10, fs=100, output="sos"), rate)
    return boreal.BorealDrive("made", rate, felt, pace, np.zeros(len(time)))


def test_c_r_of_a_sine_is_its_mean_over_the_speed():
    drive = a_drive(0.23, noise=0.0)
    assert drive.is_driven
    assert drive.c_r == pytest.approx(2 / np.pi * 0.02 / 0.23, rel=0.02)
    windows = boreal.window_c_r(drive)
    assert len(windows) == int(drive.way_m / 5)
    assert windows.mean() == pytest.approx(drive.c_r, rel=0.02)


@pytest.mark.parametrize("speed", [0.23, 0.35])
def test_lines_that_turn_with_the_wheels_are_found_at_any_speed(speed):
    drive = a_drive(speed)
    assert boreal.lugs_of([drive]) == pytest.approx(17.0, abs=0.3)
    assert boreal.lug_lines(drive, 17.0) == pytest.approx(0.02 / np.sqrt(2), rel=0.1)
    assert boreal.lug_lines(drive, 23.0) < 0.005


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
