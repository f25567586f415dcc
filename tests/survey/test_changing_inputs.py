"""Inputs that change under a run: one message, exit code 3, nothing written, no checksum of another file."""

import json
import os
from unittest.mock import Mock

import numpy as np
import pytest
from small_surveys import run, write_las

from bumpymap import layers
from bumpymap.core import FileHash
from bumpymap.core.errors import BadInputError
from bumpymap.readers import PointStats, hash_survey, open_survey
from bumpymap.readers.frames import kitti
from bumpymap.readers.las import LasSurvey
from bumpymap.scan import pipeline as scan_pipeline
from bumpymap.scan.frames import FrameReader
from bumpymap.survey.engine.collector import ReadResult, ResultCollector

pytestmark = pytest.mark.slow


def write_survey(path, lift=0.0, east=0.0):
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
    return write_survey(tmp_path / "site.las")


@pytest.fixture
def lifted_when_read(survey, monkeypatch):
    """The survey is written again, 5 m higher, as soon as its first piece was read."""
    original, done = LasSurvey.fetch, []

    def fetch(self, chunk):
        fetched = original(self, chunk)
        if self.info.path == survey and not done:
            done.append(chunk)
            again(survey, lambda path: write_survey(path, lift=5.0))
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


def test_info_refuses_it_too(lifted_when_read):
    result = run("info", lifted_when_read)
    assert result.exit_code == 3
    assert "changed while it was read" in result.output


def test_map_goes_on_without_it_where_it_may(lifted_when_read, tmp_path):
    other = write_survey(tmp_path / "other.las", east=15.0)
    out = tmp_path / "layers"
    result = run("map", lifted_when_read, other, "--out", out, "--skip-bad")
    assert result.exit_code == 4, result.output
    record = json.loads((out / "run.json").read_text(encoding="utf-8"))
    assert [entry["path"] for entry in record["inputs"]] == [str(other)]
    assert "changed while it was read" in record["skipped"][str(lifted_when_read)]


def test_map_refuses_one_that_changes_before_its_checksum_is_complete(survey, tmp_path, monkeypatch):
    original = FileHash.finish

    def finish(self, read):
        again(survey, lambda path: write_survey(path, lift=5.0))
        return original(self, read)

    monkeypatch.setattr(FileHash, "finish", finish)
    out = tmp_path / "layers"
    refused(run("map", survey, "--out", out), survey, out)


def test_the_checksum_is_that_of_the_file_that_was_read(survey, tmp_path, monkeypatch):
    """Also if another one is in its place when the layers are written."""
    state, checksum, original = survey.stat(), hash_survey(survey), layers.write_products

    def write_products(*arguments, **options):
        again(survey, lambda path: write_survey(path, lift=5.0))
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


@pytest.mark.parametrize(("owner", "moment"), [(FrameReader, "read"), (scan_pipeline, "report_frame")])
def test_scan_refuses_a_frame_that_changes(tmp_path, monkeypatch, owner, moment):
    """While it is read, or between that and its checksum."""
    frame, out = write_frame(tmp_path / "a.bin"), tmp_path / "out"
    original = getattr(owner, moment)

    def change_before(*arguments):
        again(frame, lambda path: write_frame(path, lift=5.0))
        return original(*arguments)

    monkeypatch.setattr(owner, moment, change_before)
    refused(run("scan", frame, "--out", out), frame, out)


def test_labels_that_change_belong_to_no_frame(tmp_path, monkeypatch):
    frame, labels = write_frame(tmp_path / "a.bin"), tmp_path / "a.label"
    np.zeros(30_000, "<u4").tofile(labels)
    original = kitti.read_range

    def read_range(path, *span):
        if path == labels:
            again(labels, lambda path: np.ones(30_000, "<u4").tofile(path))
        return original(path, *span)

    monkeypatch.setattr(kitti, "read_range", read_range)
    out = tmp_path / "out"
    refused(run("scan", frame, "--out", out), labels, out)


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
