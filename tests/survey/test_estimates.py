"""What is foretold of a run, what run.json says of a survey, and steps between flight lines: told, and no others."""

import json
import os
import re
import subprocess
import sys
from datetime import date
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from blake3 import blake3
from point_files import write_ply
from small_surveys import alike_surveys, layers_of, run, write_las

import bumpymap
from bumpymap.core import FeatureSettings, Reason, SeenSizes, TooUnknownError
from bumpymap.layers import MapSummary, ZoneCounts, write_products as write
from bumpymap.readers import LineSums, ReadOptions, open_survey
from bumpymap.readers.point_stats import LinedPoints
from bumpymap.survey import Budget, FlightLines, Outcome, advise, compare_lines, describe_lines, estimate, ground_line
from bumpymap.survey.pipeline import MapResult, survey_record
from bumpymap.views import write_map_views
from bumpytiles import Grid

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("without_views")]
later = pytest.mark.later


def answer(*words):
    result = run(*words, code=0)
    return json.loads(result.stdout.strip().splitlines()[-1] if words[0] == "map" else result.stdout)


def foretold_and_found(out, *words):
    """Shares of the tiles that are unknown by `info` and by `map`."""
    (record,) = answer("info", *words, "--json")["files"]
    mapped = answer("map", *words, "--local", "--out", out, "--json")
    found = sum(mapped["unknown"].values()) / mapped["tiles"]
    return sum(record["unknown_tiles_about"].values()), found


@pytest.mark.parametrize(("density", "ground_share"), [(0.4, 0.0), (5.0, 0.0), (14.0, 0.02), (0.4, 0.8), (60.0, 0.5)])
def test_what_is_foretold_is_found(tmp_path, density, ground_share):
    rng, count = np.random.default_rng(3), int(density * 60**2)
    x, y = rng.uniform(0.001, 59.999, (2, count)) + np.array([[500_001], [4_000_002]])  # 20 x 20 tiles
    kind = np.where(rng.random(count) < ground_share, 2, 1).astype(np.uint8)
    survey = write_las(tmp_path / "a.laz", x, y, rng.normal(0.0, 0.02, count), crs=None, classification=kind)
    foretold, found = foretold_and_found(tmp_path / "out", survey)
    assert foretold == pytest.approx(found, abs=0.02)


def far_from_ponds(x, y):
    ponds = np.random.default_rng(4).uniform(0.0, 60.0, (45, 2))
    return (np.hypot(x[:, None] - ponds[:, 0], y[:, None] - ponds[:, 1]) > 2.2).all(axis=1)


@pytest.mark.parametrize(
    ("seen", "density"),
    [
        pytest.param(far_from_ponds, 20.0, id="ponds"),
        pytest.param(lambda x, _: x % 2.4 < 0.3, 12.0, id="lines apart", marks=later),
        pytest.param(lambda x, y: (x + 0.2 * y) % 19.0 < 14.0, 15.0, id="gaps between flight lines", marks=later),
        pytest.param(lambda x, y: np.hypot(x % 4.0 - 2.0, y % 4.0 - 2.0) < 0.9, 15.0, id="clusters", marks=later),
    ],
)
def test_larger_tiles_are_advised_where_they_leave_fewer_unknown(tmp_path, seen, density):
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0.0, 60.0, (2, int(density * 60.0**2)))
    x, y = x[seen(x, y)], y[seen(x, y)]
    survey = write_las(tmp_path / "a.laz", 500001 + x, 4000002 + y, rng.normal(0.0, 0.02, x.size))
    (record,) = answer("info", survey, "--json")["files"]
    found = []
    for size in (3, 6):
        mapped = answer("map", survey, "--tile-size", size, "--out", tmp_path / f"{size}", "--json")
        found.append(sum(mapped["unknown"].values()) / mapped["tiles"])
    assert sum(record["unknown_tiles_about"].values()) == pytest.approx(found[0], abs=0.03)
    assert record["unknown_tiles_with"]["--tile-size 6"] == pytest.approx(found[1], abs=0.03)
    assert ("--tile-size 6" in record["needs"][-1]) == (found[0] > 0.1 and found[1] < 0.5 * found[0])


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["churo_sparse.laz", "csf_double_xyz.ply", "bcts_adjoining/bcts_1.laz"])
@pytest.mark.parametrize("ground", ["auto", "all"])
def test_what_is_foretold_of_real_surveys_is_found(tmp_path, shared_data, name, ground):
    survey = shared_data / "surveys" / name
    foretold, found = foretold_and_found(tmp_path / "out", survey, "--ground", ground)
    assert foretold == pytest.approx(found, abs=0.03)


@pytest.mark.parametrize(
    ("measured", "every", "options"),
    [
        ("points", 20.0, set()),
        ("ground points", 200.0, {"all", "csf"}),
        ("ground points", 2.0, set()),
        ("ground points (found by the cloth)", 200.0, {"all"}),
    ],
)
def test_which_ground_would_leave_fewer_tiles_unknown(measured, every, options):
    said = advise(Outcome(100, {Reason.NO_GROUND: 90}, measured, 20.0, every, True), FeatureSettings())
    assert set(re.findall(r"--ground (\w+)", said)) == options


QUARRY = Path(__file__).resolve().parents[2] / "sample_data" / "quarry.laz"
NOTHING = (float("nan"),) * 5


def map_result(*, ground_only=False, **objects):
    zones = ZoneCounts(1, 100, 900.0, 1.0, 0, 0)
    counts = (100, 20_000, (100, 0, 0, 0), (0,) * 6, 0, NOTHING, NOTHING, 200.0, 0, 0)
    summary = MapSummary(*counts, **objects, seen=SeenSizes(), zones=zones)
    return MapResult((), summary, 20_000, ground_only, {}, {}, FlightLines())


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (map_result(judged=100, layered=83, tall=90), "`ground='csf'`"),
        (map_result(judged=100, layered=5, tall=21), "`ground='all'`"),
        (map_result(judged=100, layered=6, tall=5), ""),
        (map_result(judged=100, layered=83, tall=90, ground_only=True), ""),
    ],
)
def test_which_ground_a_survey_wants(found, words):
    said = ground_line(found)
    assert words in said
    assert bool(said) == bool(words)


def test_more_unknown_tiles_than_allowed_are_exit_code_4_and_keep_the_layers(tmp_path):
    out = tmp_path / "out"
    words = ("map", QUARRY, "--out", out, "--quiet", "--set")
    failed = run(*words, "max_unknown=0.1%", code=4)
    assert "max_unknown" in failed.output
    assert json.loads((out / "run.json").read_text())["counts"]["unknown"] > 0
    run(*words, "max_unknown=50%", code=0)  # the same run, already done
    with pytest.raises(TooUnknownError):
        bumpymap.map_survey(QUARRY, out, max_unknown=0.001)


APART = ["/home/me/a.laz", "/home/me/more/b.laz"]


@pytest.mark.parametrize(
    ("given", "files", "name"),
    [
        (["flights/site.laz"], ["flights/site.laz"], "site"),
        (["flights"], ["flights/site.1.copc.laz"], "site.1"),
        ([".copc.laz"], [".copc.laz"], ".copc.laz"),
        (["/x/hill"], ["/x/hill/one/a.laz", "/x/hill/two/b.laz"], "hill"),  # though files lie deeper
        (["/x/hill/a.laz", "/x/hill/b.laz"], ["/x/hill/a.laz", "/x/hill/b.laz"], "hill"),
        (APART, APART, "2 files"),
        (["x"], [os.fsdecode(b"caf\xe9\n\x01.laz")], "caf" + 3 * "\N{REPLACEMENT CHARACTER}"),
    ],
)
def test_a_survey_is_called_after_its_file_or_its_folder(given, files, name):
    places = [list(map(Path, some)) for some in (given, files)]
    assert survey_record(*places, ["a:1"] * len(files), [None] * len(files))["name"] == name


def test_checksum_and_dates_are_those_of_all_files():
    def found(checksums, dates=()):
        record = survey_record(["x"], ["x"] * len(checksums), checksums, dates)
        return record["checksum"], record["dates"]

    assert found(["blake3:12"], [date(2024, 5, 3)]) == ("blake3:12", ["2024-05-03", "2024-05-03"])
    joined = f"blake3-set:{blake3(b'm:a' + bytes([10]) + b'm:b' + bytes([10])).hexdigest()}"
    days = [date(2024, 5, 3), None, date(2023, 12, 31)]
    assert found(["m:b", "m:a"], days) == found(["m:a", "m:b"], days) == (joined, ["2023-12-31", "2024-05-03"])
    assert found(["m:a", "m:a"])[0] != joined
    assert found(["m:a", None], [None, None]) == (None, None)


def write_points(path, points, ground=False):
    return write_las(path, *points.T, crs=None, classification=np.where(ground, 2, 1) * np.ones(len(points), np.uint8))


def bytes_in(folder, names="*"):
    return sum(path.stat().st_size for path in folder.rglob(names) if path.is_file())


def map_and_look(surveys, folder, budget, monkeypatch):
    """Map; gives what was foretold, and the bytes on disk before the layers were written, and after.

    Records of a run that do not grow with the map (settings, lists of what was read) are left out.
    """
    for name, most in zip(("waiting_points", "chunk_points"), budget, strict=True):
        monkeypatch.setattr(Budget, name, most)
    foretold = estimate([open_survey(path, ReadOptions()).info for path in surveys], Grid(), Budget(1 << 30, 2))
    found = {}

    def write_products(*arguments, **options):
        found["scratch"] = bytes_in(folder / "scratch", "*.pack")
        found["tiles"] = bytes_in(folder / "layers", "*.pack")
        return write(*arguments, **options)

    monkeypatch.setattr("bumpymap.layers.write_products", write_products)
    monkeypatch.setattr("bumpymap.views.write_map_views", write_map_views)
    options = ("--out", folder / "layers", "--set", f"scratch={folder / 'scratch'}", "--local", "--quiet")
    run("map", *surveys, *options, code=0)
    found["layers"] = bytes_in(folder / "layers")
    found["count"] = json.loads((folder / "layers" / "run.json").read_text())["counts"]["tiles"]
    return foretold, found


def full_tiles(folder, files, west, side, points_a_pixel):
    """Surveys in a row, 48 m (a block) from one to the next: points in nearly every pixel, some of them ground."""
    rng = np.random.default_rng(0)
    surveys = []
    for number in range(files):
        count = int(points_a_pixel * (side / 0.2) ** 2)
        points = rng.uniform(0, 1, (count, 3)) * (side, side, 3) + (west + 48 * number, 4_000_034, 0)
        surveys.append(write_points(folder / f"{number}.las", points, ground=rng.random(count) < 0.5))
    return surveys


def test_tiles_and_layers_take_nearly_what_was_said_and_no_more(tmp_path, monkeypatch):
    # Each file fills a block of its own (they begin at multiples of 48 m): it is complete, and measured both for its
    # ground and for all points, before it is known which will count. Random heights cannot be compressed.
    surveys = full_tiles(tmp_path, 5, 499_970, 44, 3)
    foretold, found = map_and_look(surveys, tmp_path, (180_000, 50_000), monkeypatch)
    assert found["count"] == foretold.tiles == 5 * 16 * 16
    taken = found["tiles"] + found["layers"]
    assert 0.76 * foretold.out < taken <= foretold.out


def test_points_that_wait_take_nearly_what_was_said_and_no_more(tmp_path, monkeypatch):
    # Each file reaches into the block of the next one: all points wait for the last file.
    surveys = [*full_tiles(tmp_path, 3, 499_990, 44, 1)]
    surveys.append(write_points(tmp_path / "all.las", np.array([[499_990.0, 4_000_034, 0], [500_150.0, 4_000_080, 0]])))
    foretold, found = map_and_look(surveys, tmp_path, (15_000, 4_000), monkeypatch)
    assert 0.85 * foretold.scratch < found["scratch"] <= foretold.scratch


@pytest.mark.later
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's own account of a process")
def test_a_run_takes_more_than_three_tenths_of_the_memory_that_was_said_and_no_more(tmp_path):
    # What the system says of a child when it has ended (ru_maxrss) may be the size of the parent that started it.
    code = """
import re, sys
from bumpymap.cli import main
main(sys.argv[1:], standalone_mode=False)
print(re.search(r"VmHWM:\\s*(\\d+) kB", open("/proc/self/status").read())[1])
"""
    survey = str(QUARRY)
    # How much is held at once depends on what the threads that write layers do at the same time: up to 160 MB.
    held = []
    for out in ("first", "second", "third"):
        options = ["map", survey, "--out", str(tmp_path / out), "--local", "--threads", "2", "--quiet"]
        done = subprocess.run([sys.executable, "-c", code, *options], check=True, capture_output=True, text=True)
        held.append(int(done.stdout) * 1024)
    foretold = json.loads(run("info", survey, "--quick", "--set", "threads=2", "--json").stdout)
    assert 0.3 < max(held) / foretold["run"]["memory_bytes_at_most"] <= 1


def test_a_survey_larger_than_its_budget_takes_the_budget_and_a_small_one_does_not():
    info = open_survey(QUARRY, ReadOptions()).info

    def memory(files, budget):
        return estimate([info] * files, Grid(), Budget(budget << 30, 2)).memory

    # What waits in memory and what is put in order take a share of any budget; a chunk that is read does not grow.
    assert 0.6 * (2 << 30) < memory(10_000, 4) - memory(10_000, 2) <= 2 << 30
    assert memory(10_000, 4) > 0.6 * (4 << 30)
    assert memory(1, 4) == memory(1, 2)


def test_info_says_what_a_run_takes(tmp_path):
    place = np.array([500_001.0, 4_000_002.0, 0.0])
    points = place + np.random.default_rng(0).uniform(0, 9, (100, 3))
    cloud = write_points(tmp_path / "a.las", points)
    ply = write_ply(tmp_path / "a.ply", np.rec.fromarrays(points[:1].T, names="x,y,z"), order="=")
    read = answer("info", cloud, ply, "--json")["run"]
    assert (read["points"], read["scratch_bytes_at_most"]) == (101, 0)
    assert 2 <= read["tiles_at_most"] <= 10
    run("info", QUARRY, "--quick", "--set", "memory=1MB", code=2)


# ---- steps between flight lines: told, and nothing else ----


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


def write_strips(path, rows):
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
    return write_strips(tmp_path_factory.mktemp("stepped") / "a.laz", two_strips(STEP))


def test_a_step_is_reported_and_reads_as_roughness(stepped, tmp_path):
    single = write_strips(tmp_path / "single.laz", two_strips(0.0))
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
    files = [write_strips(tmp_path / f"{line}.laz", rows[rows[:, 3] == line]) for line in (1, 2)]
    text = " ".join(run("info", *files).output.split())
    assert "heights of 1 and 2 differ by 4.0 cm" in text
    assert "strip adjustment" in text
