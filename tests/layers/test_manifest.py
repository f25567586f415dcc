import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from bumpymap.core.errors import BadInputError, OutputError
from bumpymap.core.types import CLASS_NAMES, NO_CLASS, CostTable
from bumpymap.layers import describe_file, describe_input, software_versions, write_manifest
from bumpymap.layers.manifest import complete_manifest
from bumpymap.layers.summary import summarise


@dataclass(frozen=True)
class Settings:
    out: Path
    tile_size: float
    limit: float
    crs: str | None


def test_anything_becomes_plain_json(tmp_path):
    write_manifest(
        {
            "settings": Settings(Path("a/b"), 3.0, float("nan"), None),
            "numbers": (np.float32(0.5), np.int64(7), np.array([1.0, np.inf])),
            3: {"é": True},
        },
        tmp_path / "run.json",
    )
    text = (tmp_path / "run.json").read_text(encoding="utf-8")
    assert json.loads(text, parse_constant=pytest.fail) == {
        "settings": {"out": str(Path("a/b")), "tile_size": 3.0, "limit": None, "crs": None},
        "numbers": [0.5, 7, [1.0, None]],
        "3": {"é": True},
    }


def complete(cost_map, run=None, files=()):
    table = CostTable.of(cost_map)
    return complete_manifest(run or {}, table, summarise(table), files)


def test_a_record_keeps_what_the_run_knows(cost_map):
    run = {"inputs": [{"path": "a.laz", "bytes": 7}], "settings": {"a": 1}, "versions": {"model": "7"}}
    record = complete(cost_map, run, [{"path": "class.tif"}])
    assert record["inputs"] == [{"path": "a.laz", "bytes": 7}]
    assert record["settings"] == {"a": 1}
    assert record["versions"]["model"] == "7"
    assert record["files"] == [{"path": "class.tif"}]
    assert (record["format"], record["version"]) == ("bumpymap-run", 1)


def test_inputs_get_a_checksum_if_they_are_unchanged(tmp_path):
    survey = tmp_path / "survey.laz"
    survey.write_bytes(b"points" * 1000)
    digest = hashlib.sha256(b"points" * 1000).hexdigest()
    record = {"path": survey, "points": 12, "bytes": 6000, "mtime_ns": str(survey.stat().st_mtime_ns)}
    assert describe_input(record) == record | {"sha256": digest}
    with pytest.raises(BadInputError, match="changed while"):
        describe_input(record | {"mtime_ns": "1"})


def test_a_file_that_grows_while_its_checksum_is_made_is_refused(tmp_path, monkeypatch):
    survey, made = tmp_path / "survey.laz", hashlib.file_digest
    survey.write_bytes(b"points")

    def grow(file, method):
        with survey.open("ab") as more:
            more.write(b"more")
        return made(file, method)

    monkeypatch.setattr(hashlib, "file_digest", grow)
    with pytest.raises(BadInputError, match="changed while"):
        describe_file(survey)


def test_counts_by_class_and_reason(make_map):
    cost_map = make_map(range(6), [0] * 6, [0, 0, 3, NO_CLASS, NO_CLASS, NO_CLASS], [0, 0, 0, 2, 5, 5])
    counts = complete(cost_map)["counts"]
    assert counts["by_class"] == dict(zip(CLASS_NAMES, [2, 0, 0, 1], strict=True))
    assert counts["by_reason"] == {"too few points": 1, "outlier-only relief": 2}
    assert (counts["tiles"], counts["classified"], counts["unknown"]) == (6, 3, 3)
    assert counts["points"] == cost_map.patches.count.sum()


def test_versions_of_what_has_a_say_in_the_numbers():
    assert {"bumpymap", "gdal", "numba", "numpy", "onnxruntime", "proj", "python"} <= set(software_versions())


def test_unreadable_input_and_unwritable_place(tmp_path):
    with pytest.raises(BadInputError, match=r"gone\.laz"):
        describe_file(tmp_path / "gone.laz")
    with pytest.raises(OutputError, match="cannot write"):
        write_manifest({}, tmp_path / "no" / "run.json")
