import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from bumpymap.core.errors import BadInputError
from bumpymap.layers import describe_file, describe_input, write_manifest


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
