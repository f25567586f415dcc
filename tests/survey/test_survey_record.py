"""What a survey is called, which data it is, and when: the entry ``survey`` of run.json."""

import json
import os
from datetime import date
from pathlib import Path

import laspy
import pytest
from blake3 import blake3
from small_surveys import run, write_survey

from bumpymap.survey.run_record import survey_record

APART = ["/home/me/a.laz", "/home/me/more/b.laz"]
SIGNED = "https://me:word@example.org/deep/my%20site.laz?X-Signature=abc#x"


@pytest.mark.parametrize(
    ("given", "files", "name"),
    [
        (["flights/site.laz"], ["flights/site.laz"], "site"),
        (["flights"], ["flights/site.1.copc.laz"], "site.1"),
        ([".copc.laz"], [".copc.laz"], ".copc.laz"),
        (["/x/hill"], ["/x/hill/one/a.laz", "/x/hill/two/b.laz"], "hill"),  # though files lie deeper
        (["/x/hill/a.laz", "/x/hill/b.laz"], ["/x/hill/a.laz", "/x/hill/b.laz"], "hill"),
        (APART, APART, "2 files"),
        (["/"], APART, "2 files"),
        ([SIGNED], [SIGNED], "my site"),  # neither server nor query is told
        (["s3://bucket/hill/"], ["s3://bucket/hill/a.laz", "s3://bucket/hill/b.laz"], "hill"),
        (["x"], [os.fsdecode(b"caf\xe9\n\x01.laz")], "caf" + 3 * "\N{REPLACEMENT CHARACTER}"),
    ],
)
def test_a_survey_is_called_after_its_file_or_its_folder(given, files, name):
    places = [[place if "://" in place else Path(place) for place in some] for some in (given, files)]
    assert survey_record(*places, ["a:1"] * len(files), [None] * len(files))["name"] == name


def test_the_checksum_of_one_file_is_kept_and_those_of_several_make_one():
    def found(*checksums):
        return survey_record(["x"], ["x"] * len(checksums), checksums, [])["checksum"]

    assert found("blake3-1MiB:12") == "blake3-1MiB:12"
    joined = blake3(b"m:a\nm:b\n").hexdigest()
    assert found("m:b", "m:a") == found("m:a", "m:b") == f"blake3-set:{joined}"
    assert found("m:a", "m:b") != found("m:a", "m:a")
    assert found("m:a", None) is None
    assert found(None) is None


def test_dates_are_the_first_and_the_last_that_are_known():
    def found(*dates):
        return survey_record(["x"], ["x"] * len(dates), [None] * len(dates), dates)["dates"]

    assert found(date(2024, 5, 3)) == ["2024-05-03", "2024-05-03"]
    assert found(date(2024, 5, 3), None, date(2023, 12, 31)) == ["2023-12-31", "2024-05-03"]
    assert found(None, None) is None


@pytest.mark.slow
def test_a_run_and_a_resumed_one_say_the_same_of_a_survey_with_a_bad_file(tmp_path, monkeypatch):
    folder = tmp_path / "hill"
    for name, day in (("a.laz", 3), ("b.las", 1)):
        las = laspy.read(write_survey(folder / name, seed=day))
        las.header.creation_date = date(2024, 5, day)
        las.write(folder / name)
    (folder / "bad.laz").write_bytes(b"LASF")
    words = ("map", folder, "--skip-bad", "--out")
    assert run(*words, tmp_path / "plain").exit_code == 4

    def stop(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("bumpymap.layers.write_products", stop)
        assert run(*words, tmp_path / "again").exit_code == 130
    assert run(*words, tmp_path / "again").exit_code == 4
    record, again = (json.loads((tmp_path / name / "run.json").read_text()) for name in ("plain", "again"))
    assert record["survey"]["name"] == "hill"
    assert record["survey"]["dates"] == ["2024-05-01", "2024-05-03"]
    lines = "".join(f"{checksum}\n" for checksum in sorted(file["checksum"] for file in record["inputs"]))
    assert record["survey"]["checksum"] == f"blake3-set:{blake3(lines.encode()).hexdigest()}"
    assert again["survey"] == record["survey"]
