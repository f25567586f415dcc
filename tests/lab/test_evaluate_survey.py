"""Drives held against ratings: statistics by SciPy and scikit-learn, which patches are driven, whole runs."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, strategies as st
from scipy.stats import spearmanr
from sklearn.isotonic import IsotonicRegression
from sklearn.metrics import confusion_matrix, roc_auc_score

from bumpymap.cli import main
from bumpymap.core.errors import BadInputError
from bumpymap.core.interrupts import SilentProgress
from bumpymap.lab.evaluate import agreement, survey_trial
from bumpymap.lab.evaluate.survey_trial import Subject, Verdict, open_readers
from bumpymap.lab.settings import EvaluateSettings
from bumpymap.lab.simulate.drive import DriveSettings, PatchDrives
from bumpymap.rating import Calibration, TextureModel
from bumpymap.readers import ReadOptions

SEEDS = st.integers(0, 2**31)
LIMITS = (0.1, 0.3, 0.5)
QUARRY = Path(__file__).resolve().parents[2] / "sample_data" / "quarry_part.ply"
"""A part of the sample survey, 36 whole tiles."""


@given(SEEDS, st.integers(3, 60))
def test_rank_correlation_is_that_of_scipy_ties_and_all(seed, count):
    first, second = np.random.default_rng(seed).integers(0, 9, (2, count)).astype(float)
    if np.ptp(first) and np.ptp(second):
        assert agreement.spearman(first, second) == pytest.approx(spearmanr(first, second).statistic)
    else:
        assert np.isnan(agreement.spearman(first, second))


@given(SEEDS, st.integers(2, 60))
def test_monotone_fit_is_isotonic_regression_on_the_logarithm(seed, count):
    rng = np.random.default_rng(seed)
    predictor, c_r = rng.integers(0, 20, count).astype(float), np.exp(rng.normal(size=count))
    wanted = rng.uniform(-3, 23, 30)
    oracle = IsotonicRegression(out_of_bounds="clip").fit(predictor, np.log(c_r)).predict(wanted)
    np.testing.assert_allclose(agreement.monotone_fit(predictor, c_r, wanted), np.exp(oracle), rtol=1e-9)


@given(SEEDS, st.integers(2, 40))
def test_area_under_the_curve_is_that_of_every_single_drive(seed, count):
    rng = np.random.default_rng(seed)
    p_fail = np.round(rng.random(count), 1)
    failed, completed = rng.integers(0, 5, (2, count))
    failed[0], completed[1] = failed[0] + 1, completed[1] + 1
    labels = np.repeat(np.tile([1, 0], count), np.stack([failed, completed], axis=1).ravel())
    scores = np.repeat(np.repeat(p_fail, 2), np.stack([failed, completed], axis=1).ravel())
    assert agreement.fail_auc(p_fail, failed, completed) == pytest.approx(roc_auc_score(labels, scores))


@given(SEEDS, st.integers(1, 60))
def test_confusion_matrix_is_that_of_scikit_learn(seed, count):
    driven, predicted = np.random.default_rng(seed).integers(0, 4, (2, count))
    table = agreement.confusion(driven, predicted, 4)
    assert np.array_equal(table, confusion_matrix(driven, predicted, labels=range(4)))
    away = np.abs(driven - predicted)
    shares = {"same": (away == 0).mean(), "one_off": (away == 1).mean(), "further": (away > 1).mean()}
    assert agreement.class_shift(table) == pytest.approx(shares)
    assert all(np.isnan(share) for share in agreement.class_shift(np.zeros((4, 4), np.int64)).values())


def test_reliability_counts_patches():
    found = agreement.reliability(np.array([0.1, 0.15, 0.5, 1.0]), np.array([0.0, 0.25, 0.5, 1.0]))
    assert [one["patches"] for one in found] == [2, 0, 1, 0, 1]
    assert found[0]["predicted"] == pytest.approx(0.125)
    assert [found[i]["share_failed"] for i in (0, 2, 4)] == [0.125, 0.5, 1.0]
    assert np.isnan(found[1]["predicted"])


def test_where_half_of_the_drives_failed_the_class_is_the_last():
    c_r = np.array([0.05, 0.05, 0.2, np.nan, 0.1])
    share = np.array([0.0, 0.5, 0.49, 1.0, 0.0])
    assert agreement.driven_class(c_r, share, (0.1, 0.3, 0.5)).tolist() == [0, 3, 1, 3, 1]


def verdict_of(c_r, class_id=None, p_fail=None):
    """What a rating may say."""
    c_r = np.asarray(c_r, float)
    none = np.zeros(len(c_r))
    class_id = np.asarray(none if class_id is None else class_id, np.uint8)
    p_fail = none if p_fail is None else np.asarray(p_fail, float)
    return Verdict(class_id, c_r, c_r / 1.2, c_r * 1.2, p_fail, none + 0.8)


def driven_of(c_r, failed):
    """Sixteen drives over each patch, with an error of 3 %."""
    return agreement.DriveStats(c_r, 0.03 * c_r, 16 - failed, failed)


def test_drives_are_summed_up():
    patches = [
        PatchDrives(("completed", "stuck", "completed"), (0.1, None, 0.3)),
        PatchDrives(("rolled", "stuck"), (None, None)),
        PatchDrives(("completed",), (0.2,)),
    ]
    found = agreement.DriveStats.of(patches)
    np.testing.assert_allclose(found.c_r, [0.2, np.nan, 0.2])
    np.testing.assert_allclose(found.error, [0.1, np.nan, np.nan])
    assert (found.completed.tolist(), found.failed.tolist()) == ([2, 0, 1], [1, 2, 0])
    assert found.comparable.tolist() == [False, False, True]


def test_a_perfect_prediction_is_perfect():
    c_r = np.geomspace(0.02, 0.9, 40)
    verdict = verdict_of(c_r, np.searchsorted(LIMITS, c_r, side="right"))
    driven, none = driven_of(c_r, np.zeros(40, int)), np.zeros(40, bool)
    found = agreement.compare({"ride": verdict}, {"height": c_r**2}, driven, none, LIMITS)
    own, plain = found.agreement["ride"], found.agreement["height"]
    assert own.spearman == pytest.approx(1) == plain.spearman
    assert (own.median_error, own.steps["same"], own.coverage["held"]) == (pytest.approx(0), 1, 1)
    assert 0 < plain.median_error < 0.1
    assert plain.fail is None
    assert (found.left_out, found.label_error, found.label_error_over) == (0, pytest.approx(0.03), 0)


def test_survivors_are_not_compared_but_their_failures_count():
    c_r = np.array([0.1, 0.2, 0.3, 0.4])
    driven = driven_of(np.array([0.1, 0.2, 0.3, 99.0]), np.array([0, 0, 4, 5]))
    verdict = verdict_of(c_r, [1, 1, 2, 2], p_fail=[0.1, 0.1, 0.9, 0.9])
    found = agreement.compare({"ride": verdict}, {"height": c_r}, driven, np.array([False, False, True, False]), LIMITS)
    assert (found.patches, found.left_out, found.beyond_limit, found.failed) == (4, 1, 1, 9)
    own = found.agreement["ride"]
    assert own.median_error == pytest.approx(0)
    assert sum(map(sum, own.confusion)) == 3  # the class of the one beyond the slope limit is a rule
    # Every patch counts alike: shares 9/16 of failures against 2 of safe ground and 23/16 of the same ground.
    assert own.fail["auc"] == pytest.approx((2 + 23 / 16 / 2) / (2 + 23 / 16))
    assert own.fail["auc_below_limit"] == pytest.approx((2 + 11 / 16 / 2) / (2 + 11 / 16))
    # Shares of 0, 0, 4/16 and 5/16: of 9/16 * 55/16 pairs, 2 * 9/16 are safe, the others of four and five compare.
    assert found.auc_most == pytest.approx((2 * 9 + 5 * 12 / 16 + (4 * 12 + 5 * 11) / 32) / (9 * 55 / 16))


def test_ground_that_nothing_crosses_leaves_only_failures_to_compare():
    driven = agreement.DriveStats(*np.full((2, 3), np.nan), np.zeros(3, np.int64), np.full(3, 4))
    found = agreement.compare(
        {"ride": verdict_of([0.1, 0.2, 0.3])}, {"height": np.ones(3)}, driven, np.zeros(3, bool), LIMITS
    )
    assert found.left_out == 3
    assert np.isnan(found.agreement["ride"].median_error)
    assert found.agreement["ride"].confusion[3] == [3, 0, 0, 0]
    assert "height" not in found.agreement


def test_rows_hold_means_medians_and_shares_and_what_does_not_rise_is_named():
    class_id = [0, 0, 1, 1, 2, 3]
    variance, residual = np.array([1.0, 3.0, 4.0, 6.0, 7.0, 9.0]), np.array([0.1, 0.3, 0.4, np.nan, 0.7, 0.9])
    found = agreement.class_table(verdict_of([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], class_id), variance, residual)
    first, second = found["rows"][:2]
    assert (first["tiles"], first["share"]) == (2, pytest.approx(1 / 3))
    assert (first["variance_mean"], first["residual_median"], first["c_r_median"]) == pytest.approx((2, 0.2, 0.15))
    assert second["residual_mean"] == 0.4
    assert all(found["rises"].values())
    other = agreement.class_table(verdict_of([0.1, 0.2, 0.3, 0.4, 0.5, 0.3], class_id), variance[::-1], residual)
    falls = {name for name, rises in other["rises"].items() if not rises}
    assert falls == {"variance_median", "variance_mean", "c_r_median"}


@given(SEEDS)
def test_every_stratum_gives_as_many_patches_as_it_can_and_more_patches_keep_those_of_before(seed):
    rng = np.random.default_rng(seed)
    c_r, p_fail, priority = np.exp(rng.normal(-1, 1, 2000)), rng.random(2000) ** 3, rng.random(2000)
    stratum = survey_trial.strata(c_r, p_fail)
    few, chosen = (set(survey_trial.choose_patches(stratum, priority, total).tolist()) for total in (120, 300))
    assert len(chosen) == 300
    assert np.array_equal(stratum == survey_trial.BINS, p_fail >= 0.5)  # of what is expected to fail
    assert few < chosen
    there, taken = (np.bincount(part, minlength=survey_trial.BINS + 1) for part in (stratum, stratum[list(chosen)]))
    short = taken < taken.max() - 1
    assert np.array_equal(taken[short], there[short])


def test_holes_are_filled_on_the_same_plane(measure_points):
    axis = (np.arange(30) + 0.5) * 0.1
    x, y = (part.ravel() for part in np.meshgrid(axis, axis))
    z = 1500 + 0.3 * x - 0.1 * y + 0.05 * np.sin(4 * x) * np.cos(3 * y)
    kept = np.hypot(x - 1.2, y - 1.8) > 0.4
    whole, holed = measure_points(x, y, z), measure_points(x[kept], y[kept], z[kept])
    assert np.isnan(holed.heights[0]).any()
    apart = survey_trial.driven_ground(holed)[0] - survey_trial.driven_ground(whole)[0]
    assert np.isfinite(apart).all()
    assert np.ptp(apart) < 0.12


@pytest.fixture(scope="session")
def subject():
    return Subject.of(Calibration.shipped("warthog"), TextureModel.shipped())


@pytest.fixture(scope="session")
def settings():
    """Few and short drives."""
    drive = DriveSettings(settle_s=0.5, ramp_s=0.5, cruise_s=0.0, measure_s=1.0)
    return EvaluateSettings(total_patches=10, min_starts=2, max_starts=2, drive=drive)


@pytest.fixture
def fake_drives(monkeypatch):
    """Drives that cost nothing: C_r is the relief. Returns the keys of those that were made."""
    made = []

    def run(_profile, _tile_size, _settings, job):
        made.append(job.key)
        c_r = 0.01 + float(np.std(job.heights))
        return PatchDrives(("completed",) * 2, (c_r, 1.05 * c_r))

    monkeypatch.setattr(survey_trial, "require_dart", lambda: None)
    monkeypatch.setattr(survey_trial, "drive_job", run)
    return made


def evaluate(subject, settings, out):
    options = ReadOptions(crs="EPSG:32632")
    trial = survey_trial.TrialOptions(out, 1, overwrite=False, progress=SilentProgress())
    readers = open_readers([QUARRY], options, local=False)
    return survey_trial.evaluate_survey(readers, options, "all", subject, settings, trial)


@pytest.mark.slow
def test_a_survey_is_driven_and_rated(subject, settings, tmp_path):
    pytest.importorskip("dartpy")
    found = evaluate(subject, settings, tmp_path)
    own = found.comparison
    assert (own.patches, own.drives) == (10, 20)
    assert set(own.agreement) >= {"ride", "table"}
    assert sum(row["tiles"] for row in found.classes["ride"]["rows"]) == found.facts["judged_tiles"]
    assert [path.suffix for path in tmp_path.iterdir()] == [".jsonl"]


def test_a_survey_too_sparse_to_judge_says_why(subject, settings, tmp_path):
    picky = replace(settings, features=replace(settings.features, min_points=100_000))
    with pytest.raises(BadInputError, match=r"too few points: \d+"):
        evaluate(subject, picky, tmp_path)


@pytest.fixture
def cli(subject, tmp_path):
    """The command with a calibration file of the subject."""
    (tmp_path / "own.json").write_text(subject.calibration.to_json())

    def run(survey, *words):
        files = ["--calibration", tmp_path / "own.json", "--out", tmp_path / "o"]
        given = [survey, *files, "--set", "crs=EPSG:32632", "--jobs", 1, *words]
        return CliRunner().invoke(main, ["evaluate", "survey", *map(str, given)])

    return run


def test_command_writes_a_report_and_drives_nothing_twice_for_another_calibration(subject, tmp_path, fake_drives, cli):
    own = subject.calibration
    few = ("--set", "total_patches=10")
    result = cli(QUARRY, *few)
    assert result.exit_code == 0, result.output
    text = (tmp_path / "o" / "report.md").read_text()
    record = json.loads((tmp_path / "o" / "report.json").read_text())
    assert (record["format"], list(record["classes"])) == ("bumpymap-evaluation", ["ride", "table"])
    agreement = record["comparison"]["agreement"]
    assert agreement["z_variance"]["coverage"] is None
    assert len(record["patches"]["names"]) == len(record["patches"]["driven"]["c_r"]) == 10
    for words in (
        f"{record['facts']['judged_tiles']} tiles classified",
        f"**warthog, `table`**: C_r is off by {100 * agreement['table']['median_error']:.1f} %",
        "10 patches, 20 drives, 0 of them failed",
    ):
        assert words in text
    assert "nan" not in text
    assert {path.suffix for path in (tmp_path / "o").iterdir()} == {".json", ".jsonl", ".md"}
    refused = cli(QUARRY, *few)
    assert refused.exit_code == 3
    assert "--overwrite" in refused.output
    for calibration, total in ((own, 10), (replace(own, class_limits=(0.05, 0.2, 0.4)), 10), (own, 15)):
        (tmp_path / "own.json").write_text(calibration.to_json())
        assert cli(QUARRY, "--set", f"total_patches={total}", "--overwrite").exit_code == 0
        assert len(fake_drives) == total
    gone = cli(tmp_path / "gone.laz", "--out", tmp_path / "none")
    assert (gone.exit_code, (tmp_path / "none").exists()) == (3, False)
    assert "does not exist" in gone.output


def test_a_run_that_is_broken_off_says_how_to_go_on(tmp_path, fake_drives, cli, monkeypatch):
    drive = survey_trial.drive_job

    def interrupted(*job):
        if len(fake_drives) == 5:
            raise KeyboardInterrupt
        return drive(*job)

    with monkeypatch.context() as during:
        during.setattr(survey_trial, "drive_job", interrupted)
        result = cli(QUARRY, "--set", "total_patches=12")
    assert result.exit_code == 130
    assert "same command again" in result.output
    assert [path.suffix for path in (tmp_path / "o").iterdir()] == [".jsonl"]
    result = cli(QUARRY, "--set", "total_patches=12")
    assert result.exit_code == 0, result.output
    assert len(fake_drives) == 12
    assert "12 patches, 24 drives, 0 failed" in result.output
