"""Maps at other speeds, as a user makes them: the layer, its columns, what stays, what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from small_surveys import files_in, run, write_las

import bumpymap
from bumpymap.core import UsageError

pytestmark = pytest.mark.slow

NAMES = tuple(f"{name}_{speed}" for speed in ("0.5", "1", "2") for name in ("c_r", "c_roll", "a_w"))


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """Rubble in the east; in the north-west, points so few that tiles have no heightmap."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0.01, 29.99, (2, 60_000))
    kept = (x > 12) | (y < 18) | (rng.random(60_000) < 0.05)
    x, y = x[kept], y[kept]
    z = 100 + 0.02 * x + np.where(x > 15, 0.15 * np.sin(5 * x) * np.sin(4 * y), 0.0) + 0.004 * rng.normal(size=len(x))
    return write_las(tmp_path_factory.mktemp("survey") / "site.laz", x + 500_001, y + 4_000_002, z)


@pytest.fixture(scope="module")
def maps(survey, tmp_path_factory):
    """The map, the map with three speeds, and that at 2 m/s with them."""
    out = tmp_path_factory.mktemp("maps")
    wanted = {"plain": (), "speeds": ("--set", "speeds=0.5,1,2"), "fast": ("--speed", 2, "--set", "speeds=0.5,1,2")}
    for name, options in wanted.items():
        made = run("map", survey, "--out", out / name, *options)
        assert made.exit_code == 0, made.output
    return out


def bands(path):
    with rasterio.open(path) as file:
        return dict(zip(file.descriptions, file.read(), strict=True))


def test_the_other_layers_keep_their_bytes(maps):
    plain, speeds = (files_in(maps / name) for name in ("plain", "speeds"))
    same = [name for name in plain if name.endswith(".tif")]
    assert len(same) == 9
    assert all(plain[name] == speeds[name] for name in same)
    assert not (maps / "plain" / "rasters/speeds.tif").exists()


def test_at_the_speed_of_the_map_c_r_is_that_of_the_map(maps):
    for name, own in (("speeds", "c_r_1"), ("fast", "c_r_2")):
        felt, map_bands = bands(maps / name / "rasters/speeds.tif"), bands(maps / name / "rasters/roughness.tif")
        assert tuple(felt) == NAMES
        np.testing.assert_array_equal(felt[own], map_bands["c_r"])


def test_one_map_tells_the_same_as_two(maps):
    """C_r at 2 m/s is the same, whether the map is made at 1 m/s or at 2; tiles of few points and steps nearly."""
    slow = bands(maps / "speeds" / "rasters/speeds.tif")["c_r_2"]
    fast = bands(maps / "fast" / "rasters/roughness.tif")["c_r"]
    error = np.abs(np.log(slow / fast))
    assert np.nanmedian(error) < 1e-5
    assert np.nanmax(error) < 0.25


def test_layers_say_their_speed_and_fail_as_before(maps):
    with rasterio.open(maps / "fast" / "rasters/class.tif") as file:
        tags = file.tags()
    assert (tags["speed_m_per_s"], tags["p_fail_speed_m_per_s"]) == ("2.0", "1.0")
    vehicle = json.loads((maps / "fast" / "run.json").read_text())["vehicle"]
    assert (vehicle["speed_mps"], vehicle["drives_mps"]) == (2.0, 1.0)
    slow, fast = (bands(maps / name / "rasters/roughness.tif")["p_fail"] for name in ("plain", "fast"))
    np.testing.assert_allclose(fast, slow, rtol=0.1)  # tiles of few points are pulled to their neighbours
    dense = bands(maps / "plain" / "rasters/roughness.tif")["coverage"] > 0.75
    np.testing.assert_allclose(fast[dense], slow[dense], rtol=1e-5)


def test_they_open_in_python(maps):
    pytest.importorskip("rioxarray")
    speeds = bumpymap.open(maps / "speeds").speeds()
    assert tuple(speeds) == NAMES
    assert speeds["a_w_0.5"].attrs["units"] == "m/s2"
    tiles = bumpymap.open(maps / "speeds").tiles()
    known = bands(maps / "speeds" / "rasters/speeds.tif")["c_roll_2"]
    assert np.sort(tiles["c_roll_2"].dropna()) == pytest.approx(np.sort(known[np.isfinite(known)]))
    with pytest.raises(UsageError, match="was not asked for them"):
        bumpymap.open(maps / "plain").speeds()


def test_a_run_without_speeds_takes_the_layer_of_an_earlier_one_away(survey, tmp_path):
    assert run("map", survey, "--out", tmp_path / "out", "--set", "speeds=2").exit_code == 0
    assert (tmp_path / "out" / "rasters/speeds.tif").exists()
    again = run("map", survey, "--out", tmp_path / "out", "--set", "speeds=2")
    assert "Already done" in again.output
    other = run("map", survey, "--out", tmp_path / "out")
    assert other.exit_code != 0
    assert "speeds" in other.output
    assert run("map", survey, "--out", tmp_path / "out", "--overwrite").exit_code == 0
    assert not list(Path(tmp_path / "out").glob("speeds*"))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--speed", "9"), "holds from 0.4 to 2.5 m/s"),
        (("--set", "speeds=1,1"), "1 to 16 different speeds"),
        (("--set", "speeds=1,,2"), "value 2 of speeds is ''; it must be a number"),
        (("--set", "speeds=1", "--set", "rating=table"), "--set rating='table' knows no speed"),
        (("--speed", "1", "--set", "compat=paper"), "--set compat='paper' knows no speed"),
    ],
)
def test_speeds_that_cannot_be_are_refused(survey, tmp_path, options, said):
    made = run("map", survey, "--out", tmp_path / "out", *options)
    assert made.exit_code == 2
    assert said in made.output
    assert not (tmp_path / "out").exists()
