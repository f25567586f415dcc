"""The ride costs of named surfaces that the page shows are those that real drives give."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from bumpymap.views import degrees_line, page

DATA = Path(page.__file__).with_name("data") / "surfaces.json"
FOLDERS = {"ice": "ICE", "asphalt": "ASPHALT", "indoor floor": "FLOORING", "snow": "SNOW", "silty loam": "SANDY_LOAM"}


def ride_cost(folder):
    """C_r over the drives of a folder that go forward and nearly straight, rad/m."""
    turned = way = 0.0
    for imu in sorted(folder.glob("imu_*.csv")):
        gyro = np.genfromtxt(imu, delimiter=",", names=True)
        wheels = np.genfromtxt(imu.with_name(imu.name.replace("imu", "pro")), delimiter=",", names=True)
        speed = np.interp(gyro["time"], wheels["time"], (wheels["velL"] + wheels["velR"]) / 2)
        apart = np.interp(gyro["time"], wheels["time"], np.abs(wheels["velR"] - wheels["velL"]))
        pitch = sosfiltfilt(butter(4, 10, fs=100, output="sos"), gyro["wy"] - np.median(gyro["wy"]))
        straight = (speed > 0.15) & (apart < 0.3)
        turned += np.abs(pitch[straight]).sum() / 100
        way += speed[straight].sum() / 100
    return turned / way


@pytest.mark.realdata
def test_they_agree_with_the_drives_that_are_here(shared_data):
    """Few drives of the whole set are here, so the numbers agree to within a factor of 1.5."""
    shown = {one["name"]: one["c_r"] for one in json.loads(DATA.read_text(encoding="utf-8"))["surfaces"]}
    found = {name: ride_cost(shared_data / "drives" / "borealtc" / folder) for name, folder in FOLDERS.items()}
    assert set(shown) == set(found)
    assert {name: value / shown[name] for name, value in found.items() if not 1 / 1.5 < value / shown[name] < 1.5} == {}


def test_a_summary_says_them_in_degrees():
    line = degrees_line([0.1, np.nan, np.radians(20.0), np.nan])
    assert line.startswith("Median c_r in degrees of pitch per metre: smooth 5.7, rough 20.0; ")
    assert line.endswith("measured 2.2 on asphalt, 8.4 on snow, 16.2 on silty loam")
    assert degrees_line([np.nan] * 4) == ""


def test_they_name_their_source():
    known = json.loads(DATA.read_text(encoding="utf-8"))
    assert {"vehicle", "source", "method", "floor"} <= set(known)
    page = (Path(__file__).resolve().parents[3] / "docs" / "pages" / "ride-cost.md").read_text(encoding="utf-8")
    for one in known["surfaces"]:
        assert f"{one['c_r']:.3f}" in page
