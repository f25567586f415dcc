"""Steps between flight lines: told, and nothing else."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from small_surveys import alike_surveys, layers_of, run, write_las

from bumpymap.readers import LineSums
from bumpymap.readers.point_stats import LinedPoints
from bumpymap.survey.flight_lines import compare_lines, describe_lines

pytestmark = pytest.mark.slow

WIDTH = 60.0
CORNER = np.array([500_010.0, 4_000_000.0])


def ground(x, y):
    """Hills with slopes up to 20 degrees, and bumps."""
    return 300 + 6 * np.sin(x / 25) + 5 * np.cos(y / 19) + 0.05 * np.sin(2 * x) * np.sin(3 * y)


def strips(errors, *, overlap=0.5, density=20, length=120.0, noise=0.02, bushes=0.0, seed=0):
    """Strips side by side; ``errors`` are functions of x and y from the first strip's corner, one for each."""
    rng = np.random.default_rng(seed)
    parts = []
    for number, error in enumerate(errors):
        n = int(density * WIDTH * length)
        x, y = rng.uniform(0, WIDTH, n) + number * WIDTH * (1 - overlap), rng.uniform(0, length, n)
        z = ground(x, y) + error(x, y) + noise * rng.normal(size=n)
        z += (rng.random(n) < bushes) * rng.uniform(0, 1.5, n)
        parts.append((x + CORNER[0], y + CORNER[1], z.round(3), np.full(n, number + 1)))
    x, y, z, line = (np.concatenate(axis) for axis in zip(*parts, strict=True))
    return LinedPoints(x, y, z, np.zeros(len(x), np.uint8), line.astype(np.uint16))


def constant(value):
    return lambda x, y: value + 0 * x  # noqa: ARG005


def compared(points):
    return compare_lines(LineSums.of(points))


@pytest.mark.parametrize(("step", "density"), [(-0.04, 4), (0.3, 60), (30.0, 20)])
def test_a_constant_step_is_told(step, density):
    found = compared(strips([constant(0.0), constant(step)], density=density))
    assert found.pairs[0].step == pytest.approx(step, abs=0.005)
    assert "Have the producer do a strip adjustment" in describe_lines(found)


def test_a_tilt_is_told():
    (pair,) = compared(strips([constant(0.0), lambda x, y: 0.02 + 0.003 * (x - 45) + 0 * y])).pairs
    assert pair.tilt == pytest.approx((0.003, 0.0), abs=3e-4)
    assert pair.step == pytest.approx(0.02, abs=0.005)


def test_a_chain_of_four_lines():
    offsets = (0.0, 0.05, -0.03, 0.02)
    found = compared(strips([constant(value) for value in offsets], overlap=0.4))
    assert [pair.lines for pair in found.pairs] == [(1, 2), (2, 3), (3, 4)]
    assert [pair.step for pair in found.pairs] == pytest.approx(np.diff(offsets), abs=0.005)


@pytest.mark.parametrize("errors", [[constant(0.0)], [constant(0.0), constant(0.0)]])
def test_nothing_is_told_where_nothing_is_wrong(errors):
    found = compared(strips(errors))
    assert found.lines == len(errors)
    assert found.largest < 0.005
    assert describe_lines(found) == ""


def test_waves_of_a_bad_boresight_are_told_as_spread():
    found = compared(strips([constant(0.0), lambda x, y: 0.1 * np.sin(y / 5) + 0 * x]))
    assert found.pairs[0].spread > 0.04


def test_only_ground_is_compared_where_the_survey_is_classified():
    points = strips([constant(0.0), constant(0.04)], density=40)
    rng = np.random.default_rng(1)
    wood = rng.random(len(points.x)) < 0.5
    higher = points._replace(z=points.z + wood * (8.0 + 0.5 * points.line), kind=(~wood).astype(np.uint8))
    found = compared(higher)
    assert abs(found.pairs[0].step - 0.04) < 0.005


SITE = (500_016.0, 4_000_032.0, 300.0)
STEP = 0.04


def two_strips(step, seed=0, n=10_000):
    """Two strips of gently rolling ground, 60 m wide, that share half; x, y, z, line.

    5 points per m2 and strip: where a pixel holds points of both, their step is taken for noise, not for relief.
    """
    rng, parts = np.random.default_rng(seed), []
    for line in (1, 2):
        x, y = rng.uniform(0, 60, n) + 30 * (line - 1), rng.uniform(0, 36, n)
        z = 0.5 * np.sin(x / 7) + 0.02 * np.sin(2 * y) + 0.005 * rng.normal(size=x.size)
        z += step * (line == 2)
        parts.append(np.column_stack([x.round(3), y.round(3), z.round(4), np.full(x.size, line)]))
    return np.concatenate(parts)


def write(path, rows):
    line, scales = rows[:, 3].astype(np.uint16), (0.001, 0.001, 0.0001)
    return write_las(path, *(rows[:, :3] + SITE).T, offset=SITE, scales=scales, point_source_id=line)


def mapped(out, *words):
    with alike_surveys():
        return " ".join(run("map", "--out", out, *words, code=0).output.split())


def lines_of(out):
    return json.loads((out / "run.json").read_text())["flight_lines"]


def overlap_c_r(out):
    """Median ride cost of the tiles that both strips cover."""
    tiles = pq.read_table(out / "tiles.parquet", columns=["col", "c_r"]).to_pydict()
    east = np.array(tiles["col"]) * 3 - SITE[0]
    return float(np.nanmedian(np.array(tiles["c_r"], float)[(east >= 30) & (east < 57)]))


@pytest.fixture(scope="module")
def stepped(tmp_path_factory):
    return write(tmp_path_factory.mktemp("stepped") / "a.laz", two_strips(STEP))


def test_a_step_is_reported_and_reads_as_roughness(stepped, tmp_path):
    single = write(tmp_path / "single.laz", two_strips(0.0))
    mapped(tmp_path / "single", single)
    said = mapped(tmp_path / "report", stepped)
    assert "heights of 1 and 2 differ by 4.0 cm" in said
    (pair,) = lines_of(tmp_path / "report")["pairs"]
    assert abs(pair["step"] - STEP) < 0.002
    wanted, rough = (overlap_c_r(out) for out in (tmp_path / "single", tmp_path / "report"))
    assert rough > 1.1 * wanted


def test_off_measures_nothing_and_report_changes_no_height(stepped, tmp_path):
    for align in ("off", "report"):
        mapped(tmp_path / align, stepped, "--align", align)
    assert layers_of(tmp_path / "off") == layers_of(tmp_path / "report")
    assert lines_of(tmp_path / "off") == {"lines": 0, "pairs": []}
    again = mapped(tmp_path / "report", stepped)
    assert "Already done" in again
    assert "heights of 1 and 2 differ" in again


def test_info_tells_the_step_of_a_file_and_of_all(stepped, tmp_path):
    (file,) = json.loads(run("info", stepped, "--json").stdout)["files"]
    assert abs(file["flight_lines"]["pairs"][0]["step"] - STEP) < 0.002
    rows = two_strips(STEP)
    files = [write(tmp_path / f"{line}.laz", rows[rows[:, 3] == line]) for line in (1, 2)]
    text = " ".join(run("info", *files).output.split())
    assert "heights of 1 and 2 differ by 4.0 cm" in text
    assert "strip adjustment" in text
