"""Whole evaluations of a corner of the sample survey, with short drives."""

import json
from dataclasses import asdict, replace

import pytest
from click.testing import CliRunner

from bumpymap.cli import main
from bumpymap.core.errors import BadInputError
from bumpymap.core.interrupts import SilentProgress
from bumpymap.lab.evaluate import survey_trial
from bumpymap.lab.evaluate.rated_survey import Subject, open_readers
from bumpymap.lab.evaluate.report import plain_record
from bumpymap.lab.evaluate.survey_trial import TrialOptions, evaluate_survey
from bumpymap.readers import ReadOptions

pytestmark = pytest.mark.slow


def evaluate(quarry, subject, settings, out):
    options, trial = ReadOptions(crs="EPSG:32632"), TrialOptions(out, 1, overwrite=False, progress=SilentProgress())
    return evaluate_survey(open_readers([quarry], options, local=False), options, "all", subject, settings, trial)


def test_a_survey_is_driven_and_rated(quarry, subject, settings, tmp_path):
    pytest.importorskip("dartpy")
    found = evaluate(quarry, subject, settings, tmp_path)
    own = found.comparison
    assert (own.patches, own.drives) == (10, 20)
    assert set(own.agreement) >= {"ride", "table"}
    assert sum(row["tiles"] for row in found.classes["ride"]["rows"]) == found.facts["judged_tiles"]
    assert [path.suffix for path in tmp_path.iterdir()] == [".jsonl"]


def test_drives_are_not_made_twice_even_for_another_calibration(quarry, subject, settings, tmp_path, fake_drives):
    first = evaluate(quarry, subject, settings, tmp_path)
    assert len(fake_drives) == 10
    again = evaluate(quarry, subject, settings, tmp_path)
    assert len(fake_drives) == 10
    assert plain_record(asdict(again)) == plain_record(asdict(first))
    other = replace(subject.calibration, class_limits=(0.05, 0.2, 0.4))
    evaluate(quarry, Subject.of(other, subject.textures), settings, tmp_path)
    assert len(fake_drives) == 10
    evaluate(quarry, subject, replace(settings, total_patches=15), tmp_path)
    assert len(fake_drives) == 15


def test_a_survey_too_sparse_to_judge_says_why(quarry, subject, settings, tmp_path):
    picky = replace(settings, features=replace(settings.features, min_points=100_000))
    with pytest.raises(BadInputError, match=r"too few points: \d+"):
        evaluate(quarry, subject, picky, tmp_path)


@pytest.fixture
def cli(subject, tmp_path):
    """The command with a calibration file of the subject."""
    (tmp_path / "own.json").write_text(subject.calibration.to_json())

    def run(survey, *words):
        files = ["--calibration", tmp_path / "own.json", "--out", tmp_path / "o"]
        given = [survey, *files, "--set", "crs=EPSG:32632", "--jobs", 1, *words]
        return CliRunner().invoke(main, ["evaluate", "survey", *map(str, given)])

    return run


def test_command_writes_a_report_and_does_not_replace_it(quarry, subject, tmp_path, fake_drives, cli):
    (tmp_path / "own.json").write_text(replace(subject.calibration, ride=None).to_json())
    few = ("--set", "total_patches=10")
    result = cli(quarry, *few)
    assert result.exit_code == 0, result.output
    text = (tmp_path / "o" / "report.md").read_text()
    record = json.loads((tmp_path / "o" / "report.json").read_text())
    assert (record["format"], list(record["classes"])) == ("bumpymap-evaluation", ["table"])
    assert record["comparison"]["agreement"]["z_variance"]["coverage"] is None
    assert len(record["patches"]["names"]) == len(record["patches"]["driven"]["c_r"]) == 10
    for words in (
        "quarry_part.ply: 42,",
        f"{record['facts']['judged_tiles']} tiles classified",
        f"**warthog, `table`**: C_r is off by {100 * record['comparison']['agreement']['table']['median_error']:.1f} %",
        "10 patches, 20 drives, 0 of them failed",
    ):
        assert words in text
    assert "nan" not in text
    written = sorted(path.name for path in (tmp_path / "o").iterdir() if path.suffix != ".jsonl")
    assert written == ["report.json", "report.md"]
    refused = cli(quarry, *few)
    assert refused.exit_code == 3
    assert "--overwrite" in refused.output
    assert cli(quarry, *few, "--overwrite").exit_code == 0


def test_a_survey_that_is_not_there_leaves_no_folder(tmp_path, cli):
    result = cli(tmp_path / "gone.laz")
    assert result.exit_code == 3
    assert "does not exist" in result.output
    assert not (tmp_path / "o").exists()


def test_a_run_that_is_broken_off_says_how_to_go_on(quarry, tmp_path, fake_drives, cli, monkeypatch):
    drive = survey_trial.drive_job

    def interrupted(*job):
        if len(fake_drives) == 5:
            raise KeyboardInterrupt
        return drive(*job)

    with monkeypatch.context() as during:
        during.setattr(survey_trial, "drive_job", interrupted)
        result = cli(quarry, "--set", "total_patches=12")
    assert result.exit_code == 130
    assert "same command again" in result.output
    assert [path.suffix for path in (tmp_path / "o").iterdir()] == [".jsonl"]
    result = cli(quarry, "--set", "total_patches=12")
    assert result.exit_code == 0, result.output
    assert len(fake_drives) == 12
    assert "12 patches, 24 drives, 0 failed" in result.output
