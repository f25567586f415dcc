"""What a survey is called, which data it is, and when: the entry ``survey`` of run.json."""

import json
import os
from datetime import date
from pathlib import Path

import laspy
import pytest
from blake3 import blake3
from click.testing import CliRunner
from small_surveys import write_survey

from bumpymap.cli import main
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


def dated(path, day, **settings):
    write_survey(path, **settings)
    las = laspy.read(path)
    las.header.creation_date = day
    las.write(path)
    return path


@pytest.mark.slow
def test_a_run_a_resumed_one_and_one_with_a_bad_file_say_the_same_of_the_survey(tmp_path, monkeypatch):
    folder = tmp_path / "hill"
    dated(folder / "a.laz", date(2024, 5, 3))
    dated(folder / "b.las", date(2024, 5, 1), seed=1)
    (folder / "bad.laz").write_bytes(b"LASF")

    def record(out, *options):
        words = ["map", str(folder), "--out", str(tmp_path / out), "--skip-bad", *options]
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 4, result.output
        return json.loads((tmp_path / out / "run.json").read_text())

    run = record("plain")
    assert run["survey"]["name"] == "hill"
    assert run["survey"]["dates"] == ["2024-05-01", "2024-05-03"]
    lines = "".join(f"{file['checksum']}\n" for file in sorted(run["inputs"], key=lambda file: file["checksum"]))
    assert run["survey"]["checksum"] == f"blake3-set:{blake3(lines.encode()).hexdigest()}"

    def stop(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("bumpymap.layers.write_products", stop)
        words = ["map", str(folder), "--out", str(tmp_path / "again"), "--skip-bad"]
        assert CliRunner().invoke(main, words).exit_code == 130
    assert record("again")["survey"] == run["survey"]
