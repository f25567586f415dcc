"""Inputs: files that change under a run, that do not fit, with odd names, in a folder of an EPT, or at a signed URL."""

import json
import os
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pyarrow.parquet as pq
import pytest
import rasterio
from epts import write_ept
from range_server import serving
from small_surveys import layers_of, run, write_las, write_survey

import bumpymap
from bumpymap import layers
from bumpymap.core import recorded_place
from bumpymap.core.errors import BadInputError, OutputError
from bumpymap.readers import PointStats, hash_survey, open_survey
from bumpymap.readers.frames import read as scan_files
from bumpymap.readers.las import LasSurvey
from bumpymap.scan import pipeline as scan_pipeline
from bumpymap.scan.frames import FrameReader
from bumpymap.survey.engine.collector import ReadResult, ResultCollector

pytestmark = pytest.mark.slow


def write_site(path, lift=0.0, east=0.0):
    rng = np.random.default_rng(0)
    x, y = rng.uniform(500_001 + east, 500_016 + east, 20_000), rng.uniform(4_000_002, 4_000_017, 20_000)
    return write_las(path, x, y, 100 + lift + 0.01 * rng.standard_normal(20_000))


def again(path, write):
    """Write a file again, at a later moment."""
    before = path.stat().st_mtime_ns
    write(path)
    os.utime(path, ns=(0, before + 1_000_000_000))


@pytest.fixture
def survey(tmp_path):
    return write_site(tmp_path / "site.las")


@pytest.fixture
def lifted_when_read(survey, monkeypatch):
    """The survey is written again, 5 m higher, as soon as its first piece was read."""
    original, done = LasSurvey.fetch, []

    def fetch(self, chunk):
        fetched = original(self, chunk)
        if self.info.path == survey and not done:
            done.append(chunk)
            again(survey, lambda path: write_site(path, lift=5.0))
        return fetched

    monkeypatch.setattr(LasSurvey, "fetch", fetch)
    return survey


def refused(result, path, out):
    assert result.exit_code == 3, result.output
    assert result.output.count("Error: ") == 1
    assert f"{path} changed while" in result.output
    assert "Traceback" not in result.output
    assert not out.exists()


def test_map_refuses_a_survey_that_changes_while_it_is_read(lifted_when_read, tmp_path):
    out = tmp_path / "layers"
    refused(run("map", lifted_when_read, "--out", out), lifted_when_read, out)


def test_map_goes_on_without_it_where_it_may(lifted_when_read, tmp_path):
    other = write_site(tmp_path / "other.las", east=15.0)
    out = tmp_path / "layers"
    assert run("map", lifted_when_read, other, "--out", out, "--skip-bad").exit_code == 4
    record = json.loads((out / "run.json").read_text(encoding="utf-8"))
    assert [entry["path"] for entry in record["inputs"]] == [str(other)]
    assert "changed while it was read" in record["skipped"][str(lifted_when_read)]


def test_the_checksum_is_that_of_the_file_that_was_read(survey, tmp_path, monkeypatch):
    """Also if another one is in its place when the layers are written."""
    state, checksum, original = survey.stat(), hash_survey(survey), layers.write_products

    def write_products(*arguments, **options):
        again(survey, lambda path: write_site(path, lift=5.0))
        return original(*arguments, **options)

    monkeypatch.setattr(layers, "write_products", write_products)
    assert run("map", survey, "--out", tmp_path / "layers").exit_code == 0
    (record,) = json.loads((tmp_path / "layers" / "run.json").read_text(encoding="utf-8"))["inputs"]
    assert record["checksum"] == checksum != hash_survey(survey)
    assert (record["bytes"], record["mtime_ns"]) == (state.st_size, str(state.st_mtime_ns))


def write_frame(path, lift=0.0):
    rng = np.random.default_rng(1)
    xy = rng.uniform(-20, 20, (30_000, 2))
    z = lift + 0.01 * rng.standard_normal(30_000)
    np.column_stack([xy, z, np.zeros(30_000)]).astype("<f4").tofile(path)
    return path


@pytest.mark.parametrize(
    ("owner", "moment", "name"),
    [(FrameReader, "read", "a.bin"), (scan_pipeline, "report_frame", "a.bin"), (scan_files, "read_range", "a.label")],
)
def test_scan_refuses_a_frame_or_its_labels_that_change(tmp_path, monkeypatch, owner, moment, name):
    """While they are read, or between that and the checksum."""
    frame, changing, out = write_frame(tmp_path / "a.bin"), tmp_path / name, tmp_path / "out"
    np.zeros(30_000, "<u4").tofile(tmp_path / "a.label")
    other = write_frame(tmp_path / "other", lift=5.0) if name == "a.bin" else tmp_path / "a.bin"
    content, original = other.read_bytes()[: changing.stat().st_size], getattr(owner, moment)

    def change_before(*arguments):
        if moment != "read_range" or arguments[0] == changing:
            again(changing, lambda path: path.write_bytes(content))
        return original(*arguments)

    monkeypatch.setattr(owner, moment, change_before)
    refused(run("scan", frame, "--out", out), changing, out)


def test_ranges_that_workers_read_of_several_versions_are_no_file(survey):
    """Copies on two machines may differ in the time of their writing; what one machine reads must not."""
    reader = open_survey(survey)
    (chunk,) = reader.chunks()
    stats = reader.convert(chunk, reader.fetch(chunk)).stats
    one, two = ({"size": 7, "mtime_ns": text} for text in "12")

    def add(*seen):
        def refuse(_, error):
            raise error

        checkpoints = Mock(early=[], load_results=list)
        collector = ResultCollector([reader], [len(seen)], checkpoints, refuse)
        for number, place in enumerate(seen):
            own = stats if number == 0 else PointStats()
            collector.add(ReadResult(((0, number, number + 1),), {0: own}, seen={} if place is None else {0: place}))
        return collector

    assert add(("a", one), ("b", two), ("a", one), None).stats[0] == stats
    with pytest.raises(BadInputError, match=r"site\.las changed while it was read: workers on a saw several versions"):
        add(("a", one), ("b", two), ("a", two))


HERE = (480_717.0, 2_135_914.0)


def cloud(path, place=HERE, *, height=100.0, factor=1.0, more=(), count=2_000):
    """Level ground of 30 m x 30 m with a noise of 2 cm; ``more``: points at other places."""
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(0.0, 30.0, (count, 2)) + place, rng.normal(height, 0.02, count) * factor])
    x, y, z = np.concatenate([points, np.array(more).reshape(-1, 3)]).T
    return write_las(path, x, y, z, crs=None, offset=(x.min(), y.min(), 0.0), scales=(0.01,) * 3)


def told(files, tmp_path):
    """Return what info and map say of files in UTM zone 14, and the exit code of map."""
    words = (*files, "--crs", "EPSG:32614")
    facts = json.loads(run("info", *words, "--quick", "--json").stdout)
    return facts["doubts"], run("map", *words, "--out", tmp_path / "out")


@pytest.mark.parametrize(
    ("second", "says", "code"),
    [
        ({"place": (HERE[0] + 30.0, HERE[1]), "height": 130.0}, "of another datum", 0),
        ({"place": (HERE[0] + 30.0, HERE[1]), "factor": 1 / 0.3048}, "in feet", 0),
        ({"place": (0.0, 0.0)}, "at the origin (0, 0): leave it out?", 3),
        ({"place": (HERE[0] + 400_000.0, HERE[1])}, "lies 400 km from all other files: leave it out?", 3),
        ({"more": [(0.0, 0.0, 0.0)] * 9}, "some lie at the origin (0, 0)", 3),
        ({"more": [(HERE[0], 5e6, 100.0)]}, "there may be stray coordinates", 3),
    ],
    ids=["datum", "feet", "origin", "far", "points at the origin", "stray"],
)
def test_a_file_that_does_not_fit_is_named_with_the_evidence(tmp_path, second, says, code):
    files = cloud(tmp_path / "a.las"), cloud(tmp_path / "b.las", **second)
    doubts, mapped = told(files, tmp_path)
    assert any(says in doubt and "b.las" in doubt for doubt in doubts), doubts
    assert (mapped.exit_code, says in mapped.stderr) == (code, True)


def test_files_that_fit_are_not_doubted(tmp_path):
    beside = cloud(tmp_path / "b.las", (HERE[0] + 30.0, HERE[1]), height=104.0)
    below = cloud(tmp_path / "c.las", (HERE[0] + 90.0, HERE[1]), height=180.0)  # not beside them
    doubts, mapped = told([cloud(tmp_path / "a.las"), beside, below], tmp_path)
    assert (doubts, mapped.exit_code, "heights" in mapped.stderr) == ([], 0, False)


NAME = os.fsdecode(b"caf\xe9")
ENVIRONMENT = {"LANG": "C", "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}


@pytest.fixture
def folder(tmp_path):
    """A folder whose own name is no UTF-8 either."""
    path = tmp_path / NAME
    try:
        path.mkdir()
    except OSError:
        pytest.skip("this file system takes UTF-8 names alone")
    return path


def run_in_c_locale(code, *arguments):
    """The command in a process of its own, whose streams have the encoding of the locale; gives its two outputs."""
    if not bumpymap.__file__.isascii() or not sys.prefix.isascii():
        pytest.skip("in this locale Python reads no .pth file, and pyproj no data, under a path that is not ASCII")
    words = [sys.executable, "-c", "from bumpymap.cli import main; main()", *map(str, arguments)]
    result = subprocess.run(words, env=os.environ | ENVIRONMENT, capture_output=True, timeout=300, check=False)
    told, warned = result.stdout.decode("utf-8", "replace"), result.stderr.decode("utf-8", "replace")
    assert result.returncode == code, warned
    assert "Traceback" not in warned
    return told, warned


def test_map_and_info(folder, tmp_path):
    good, bad, out = write_survey(folder / f"{NAME}.las"), folder / f"{NAME} bad.las", folder / f"{NAME} out"
    bad.write_bytes(b"LASF" + bytes(500))
    told, warned = run_in_c_locale(3, "info", bad, good, "--json")
    assert "caf" in warned
    assert Path(json.loads(told)["files"][-1]["path"]) == good
    assert "caf" in run_in_c_locale(4, "map", bad, good, "--skip-bad", "--out", out)[1]
    record = json.loads((out / "run.json").read_text(encoding="utf-8"))
    assert [Path(entry["path"]) for entry in record["inputs"]] == [good]
    assert [Path(path) for path in record["skipped"]] == [bad]
    assert run("map", good, "--out", tmp_path / "plain").exit_code == 0
    assert layers_of(out) == layers_of(tmp_path / "plain")


def test_scan(folder):
    """A name that looks like an escaped one is that of another frame."""
    frames = [write_frame(folder / f"{name}.bin") for name in (NAME, "caf%E9", "b")]
    poses, out = folder / "poses.txt", folder / f"{NAME} out"
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
    placed = ("--poses", poses, "--crs", "EPSG:32614")
    run_in_c_locale(0, "scan", *frames, *placed, "--method", "filter", "--pictures", "--out", out)
    record = json.loads((out / "scan.json").read_text(encoding="utf-8"))
    by_path = {Path(frame["path"]): frame["name"] for frame in record["frames"]}
    assert set(by_path) == set(frames)
    names = set(by_path.values())
    assert len(names) == 3
    assert set(pq.read_table((out / "sectors.parquet").open("rb"))["frame"].to_pylist()) == names
    assert {path.name for path in (out / "frames").iterdir()} == {
        f"{name}.{ending}" for name in names for ending in ("json", "ply", "png")
    }
    assert rasterio.open((out / "map" / "rasters/class.tif").open("rb")).width > 0


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A LAZ file, and an EPT of its points whose nodes have offsets of their own."""
    folder, rng = tmp_path_factory.mktemp("made"), np.random.default_rng(1)
    x, y = rng.uniform(0.01, 190.0, (2, 100_000))
    z = 0.2 * np.sin(9 * x) * np.sin(8 * y)
    file = write_las(folder / "site.laz", x + 500_016.0, y + 4_000_032.0, z, classification=rng.integers(1, 7, 100_000))
    return file, write_ept(folder / "site", file, levels=2, split=1, offsets=True)


def test_an_ept_is_one_input_and_known_again(made, tmp_path):
    path, out = made[1], tmp_path / "out"
    (told,) = json.loads(run("info", path.parent, "--quick", "--json").stdout)["files"]
    assert (told["path"], told["format"].split(" (")[0]) == (str(path), "EPT of 21 nodes")
    assert run("map", path, "--out", out).exit_code == 0
    record = json.loads((out / "run.json").read_text())
    (known,) = record["inputs"]
    assert (known["path"], known["points"], record["survey"]["name"]) == (str(path), 100_000, "site")
    assert known["bytes"] == sum(file.stat().st_size for file in path.parent.rglob("*.*"))
    assert known["checksum"] == record["survey"]["checksum"] == hash_survey(path)
    node = path.parent / "ept-data/1-0-0-0.laz"
    os.utime(node, ns=(0, node.stat().st_mtime_ns + 1_000_000_000))
    assert run("map", path, "--out", out).output.startswith("Already done")
    spoilt = bytearray(whole := node.read_bytes())
    spoilt[-100] ^= 1
    node.write_bytes(spoilt)
    changed = run("map", path, "--out", out)
    node.write_bytes(whole)
    assert (changed.exit_code, "other inputs" in changed.output) == (3, True), changed.output


def test_an_ept_with_a_damaged_node_is_skipped_as_a_whole(made, tmp_path):
    ept = write_ept(tmp_path / "site", made[0], levels=1)
    good = write_survey(tmp_path / "good.laz")
    node = ept.parent / "ept-data/1-1-1-0.laz"
    data = bytearray(node.read_bytes())
    data[-3000:-100] = bytes(2900)
    node.write_bytes(data)
    assert run("map", good, "--out", tmp_path / "alone").exit_code == 0
    result = run("map", tmp_path, "--out", tmp_path / "out", "--skip-bad")
    assert result.exit_code == 4, result.output
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert [*record["skipped"]] == [str(ept)]
    assert str(node) in record["skipped"][str(ept)]
    assert layers_of(tmp_path / "out") == layers_of(tmp_path / "alone")


SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"


@pytest.fixture
def address():
    pytest.importorskip("aiohttp")
    with serving(SAMPLE) as (found, handler):
        handler.headers_beside = {"ETag": '"version 1"'}  # by which a later run knows that it is the same file
        yield found


def test_no_file_of_a_map_holds_the_key_of_its_survey(address, tmp_path):
    url = f"{address}/quarry.laz?X-Signature=SECRETKEY"
    layers = bumpymap.map_survey(url, out=tmp_path / "out")
    held = [path.name for path in (tmp_path / "out").rglob("*") if path.is_file() and b"SECRETKEY" in path.read_bytes()]
    assert held == []
    (known,) = layers.manifest["inputs"]
    assert known["path"] == recorded_place(url)
    assert known["path"].startswith(f"{address}/quarry.laz?left-out=")
    again = bumpymap.map_survey(url, out=tmp_path / "out")
    assert again.manifest == layers.manifest
    with pytest.raises(OutputError, match="other inputs"):
        bumpymap.map_survey(url.replace("SECRETKEY", "ANOTHER"), out=tmp_path / "out")


def test_urls_with_other_keys_are_told_apart_and_others_stay_as_they_are():
    plain = ["https://example.org/a.laz", "s3://bucket/a.laz", "/data/a.laz?b", Path("a?b.laz"), "memory://a.laz"]
    assert [recorded_place(place) for place in plain] == [str(place) for place in plain]
    signed = ["https://example.org/get?file=a", "https://example.org/get?file=b", "https://me:word@example.org/get"]
    named = {recorded_place(place) for place in signed}
    assert len(named) == 3
    assert all(name.startswith("https://example.org/get?left-out=") for name in named)
