"""Bayes' rule for the moved numbers, against dense linear algebra and made-up drives."""

import numpy as np
import pytest

from bumpymap.rating import drive_posterior as posterior
from bumpymap.rating.drive_posterior import DriveEvidence, DrivePrior, fit_move, respond

MIDDLE = np.log(0.25)
PRIOR = DrivePrior(MIDDLE, (0.2, 0.1), -np.inf)


def evidence_of(rng, n=45, numbers=(0.2, 0.05), *, prior=PRIOR, scale=1.0, line_sd=0.1):
    """Stretches in squares of three; what the map is off by is ``scale`` times what it says."""
    square = np.arange(n) // 3
    log_c_r = MIDDLE - 0.3 + rng.normal(0, 0.7, n)
    map_sd, sd = np.full(n, 0.1), np.full(n, 0.05)
    off = scale * map_sd * rng.normal(size=n)[square] + np.hypot(sd, line_sd) * rng.normal(size=n)
    measured = respond(np.array(numbers), log_c_r, prior)[0] + off
    whole = np.zeros(n, np.int64)
    return DriveEvidence(log_c_r, measured, sd**2, map_sd, square, whole, whole, np.full(n, 10.0), np.full(n, 10.0))


def test_normal_errors_give_the_textbook_answer(monkeypatch):
    """Normal own errors, a map's error and a scatter of lines of known sizes."""
    for name, value in (("FREEDOM", 1e12), ("TAIL_SCALE", 1.0), ("_SURENESS", 1.0)):
        monkeypatch.setattr(posterior, name, value)
    monkeypatch.setattr(posterior, "_SCALES", np.array([1.3]))
    monkeypatch.setattr(posterior, "_LINES", np.array([0.15]))
    evidence = evidence_of(np.random.default_rng(1))
    x = evidence.log_c_r - MIDDLE
    design = np.column_stack((np.ones(len(x)), x))
    spread = 1.3 * evidence.map_sd
    same = evidence.square[:, None] == evidence.square
    errors = np.diag(evidence.own_variance + 0.15**2) + np.outer(spread, spread) * same
    inverse = np.linalg.inv(errors)
    precision = design.T @ inverse @ design + np.diag(1 / np.square(PRIOR.sd))
    mean = np.linalg.solve(precision, design.T @ inverse @ (evidence.log_measured - evidence.log_c_r))
    found = fit_move(evidence, PRIOR)
    assert np.allclose(found.mean, mean, rtol=1e-9, atol=0)
    assert np.allclose(found.covariance, np.linalg.inv(precision), rtol=1e-9, atol=0)


@pytest.mark.parametrize(("options", "low"), [({"line_sd": 0.25}, 0.7), ({"scale": 1.5, "n": 60}, 0.65)])
def test_the_stated_uncertainty_holds(options, low):
    """The 80 % interval of both numbers, over drives whose numbers are drawn from the prior."""
    inside = []
    for seed in range(60):
        rng = np.random.default_rng([seed, 5])
        numbers = rng.normal(0.0, PRIOR.sd)
        found = fit_move(evidence_of(rng, numbers=numbers, **options), PRIOR)
        inside.append(np.abs(found.mean - numbers) < 1.2816 * np.sqrt(np.diag(found.covariance)))
    assert low < np.mean(inside) < 0.92


def test_the_maps_error_and_the_scatter_of_lines_are_told_apart():
    rng = np.random.default_rng(3)
    for scale, line_sd in ((0.6, 0.1), (2.0, 0.05), (1.0, 0.25)):
        found = fit_move(evidence_of(rng, 300, scale=scale, line_sd=line_sd), PRIOR)
        assert found.map_scale == pytest.approx(scale, rel=0.3)
        assert found.line_sd == pytest.approx(line_sd, abs=0.05)


def test_wild_stretches_hardly_move_anything():
    evidence = evidence_of(np.random.default_rng(4), 60, scale=0.5)
    calm = fit_move(evidence, PRIOR)
    evidence.log_measured[::15] += 2.0
    wild = fit_move(evidence, PRIOR)
    assert abs(wild.mean[0] - calm.mean[0]) < 0.05
    assert wild.covariance[0, 0] > calm.covariance[0, 0]


def test_ground_driven_again_says_little_more():
    """Five passes over the same squares, each with its own measurement, where the map's error rules."""
    once = evidence_of(np.random.default_rng(5), 30, line_sd=0.0)
    once.own_variance[:] = 0.02**2
    rows = np.tile(np.arange(30), 5)
    again = once.chosen(rows)
    apart = DriveEvidence(**{n: getattr(again, n) for n in again.__slots__} | {"square": np.arange(150) // 3})
    sd = [np.sqrt(fit_move(each, PRIOR).covariance[0, 0]) for each in (once, again, apart)]
    assert sd[1] > 0.8 * sd[0]
    assert sd[2] < 0.6 * sd[0]


def test_a_floor_is_found():
    prior = DrivePrior(MIDDLE, (0.2, 0.1, 1.0), np.log(0.02))
    numbers = np.array([0.2, 0.05, np.log(0.06)])
    rng = np.random.default_rng(7)
    evidence = evidence_of(rng, 200, prior=prior, numbers=numbers, scale=0.5)
    evidence.log_c_r[:] -= 1.0
    evidence.log_measured[:] = respond(numbers, evidence.log_c_r, prior)[0] + 0.05 * rng.normal(size=200)
    assert fit_move(evidence, prior).mean[2] == pytest.approx(np.log(0.06), abs=0.1)
