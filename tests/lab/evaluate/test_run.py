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


def trial(out):
    return TrialOptions(out, 1, overwrite=False, progress=SilentProgress())


def evaluate(quarry, subject, settings, out):
    options = ReadOptions()
    return evaluate_survey(open_readers([quarry], options, local=False), options, "all", subject, settings, trial(out))


def test_a_survey_is_driven_and_rated(quarry, subject, settings, tmp_path):
    pytest.importorskip("dartpy")
    found = evaluate(quarry, subject, settings, tmp_path)
    own = found.comparison
    assert own.patches == 10
    assert own.drives == 20
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


def cli(*words):
    return CliRunner().invoke(main, ["evaluate", "survey", *map(str, words)])


def test_command_writes_a_report_and_does_not_replace_it(quarry, subject, tmp_path, fake_drives):
    out, calibration = tmp_path / "trust", tmp_path / "own.json"
    calibration.write_text(replace(subject.calibration, ride=None).to_json())
    words = [quarry, "--out", out, "--calibration", calibration, "--set", "total_patches=10", "--jobs", "1"]
    result = cli(*words)
    assert result.exit_code == 0, result.output
    record = json.loads((out / "report.json").read_text())
    assert list(record["classes"]) == ["table"]
    written = sorted(path.name for path in out.iterdir() if path.suffix != ".jsonl")
    assert written == ["report.json", "report.md"]
    refused = cli(*words)
    assert refused.exit_code == 3
    assert "--overwrite" in refused.output
    assert cli(*words, "--overwrite").exit_code == 0


def test_a_survey_that_is_not_there_leaves_no_folder(subject, tmp_path):
    (tmp_path / "own.json").write_text(subject.calibration.to_json())
    words = ["--calibration", tmp_path / "own.json", "--out", tmp_path / "o"]
    result = cli(tmp_path / "gone.laz", *words)
    assert result.exit_code == 3
    assert "does not exist" in result.output
    assert not (tmp_path / "o").exists()


def test_a_run_that_is_broken_off_says_how_to_go_on(quarry, subject, tmp_path, fake_drives, monkeypatch):
    monkeypatch.setattr("bumpymap.lab.simulate.model.require_dart", lambda: None)
    (tmp_path / "own.json").write_text(subject.calibration.to_json())
    words = [
        quarry,
        "--calibration",
        tmp_path / "own.json",
        "--out",
        tmp_path / "o",
        "--set",
        "total_patches=12",
        "--jobs",
        "1",
    ]
    drive = survey_trial.drive_job

    def interrupted(*job):
        if len(fake_drives) == 5:
            raise KeyboardInterrupt
        return drive(*job)

    with monkeypatch.context() as during:
        during.setattr(survey_trial, "drive_job", interrupted)
        result = cli(*words)
    assert result.exit_code == 130
    assert "same command again" in result.output
    assert [path.suffix for path in (tmp_path / "o").iterdir()] == [".jsonl"]
    result = cli(*words)
    assert result.exit_code == 0, result.output
    assert len(fake_drives) == 12
    assert "12 patches, 24 drives, 0 failed" in result.output
