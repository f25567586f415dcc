"""Steps between flight lines: told, taken off, and left alone where nothing explains them."""

import json

import numpy as np
import pytest

from bumpymap.readers import LineSums
from bumpymap.readers._kernels import LinedPoints
from bumpymap.survey.flight_lines import (
    FlightLines,
    LineCells,
    compare_lines,
    describe_lines,
    left_after,
    steps_between_lines,
)

WIDTH = 60.0
CORNER = np.array([500_010.0, 4_000_000.0])


def ground(x, y):
    """Hills with slopes up to 20 degrees, and bumps."""
    return 300 + 6 * np.sin(x / 25) + 5 * np.cos(y / 19) + 0.05 * np.sin(2 * x) * np.sin(3 * y)


def strips(errors, *, overlap=0.5, density=20, length=120.0, noise=0.02, bushes=0.0, seed=0):
    """Strips side by side; ``errors`` are functions of x and y from the first strip's corner, one for each."""
    rng = np.random.default_rng(seed)
    parts = []
    for number, error in enumerate(errors):
        n = int(density * WIDTH * length)
        x, y = rng.uniform(0, WIDTH, n) + number * WIDTH * (1 - overlap), rng.uniform(0, length, n)
        z = ground(x, y) + error(x, y) + noise * rng.normal(size=n)
        z += (rng.random(n) < bushes) * rng.uniform(0, 1.5, n)
        parts.append((x + CORNER[0], y + CORNER[1], z.round(3), np.full(n, number + 1)))
    x, y, z, line = (np.concatenate(axis) for axis in zip(*parts, strict=True))
    return LinedPoints(x, y, z, np.zeros(len(x), np.uint8), line.astype(np.uint16))


def constant(value):
    return lambda x, y: value + 0 * x  # noqa: ARG005


def compared(points):
    sums = LineSums.of(points)
    return compare_lines(sums, adjust=True), steps_between_lines(LineCells.of(sums))


@pytest.mark.parametrize(("step", "density"), [(0.04, 4), (-0.04, 20), (0.3, 60)])
def test_a_constant_step_is_told_and_taken_off(step, density):
    found, steps = compared(strips([constant(0.0), constant(step)], density=density))
    (pair,) = found.pairs
    assert pair.lines == (1, 2)
    assert abs(pair.step - step) < 0.005
    assert found.largest == pytest.approx(abs(step), abs=0.01)
    assert found.method == "offset"
    assert abs(np.median(left_after(steps, found.corrections))) < 0.003


def test_a_tilt_is_told_and_taken_off():
    found, steps = compared(strips([constant(0.0), lambda x, y: 0.02 + 0.003 * (x - 45) + 0 * y]))
    (pair,) = found.pairs
    assert pair.tilt == pytest.approx((0.003, 0.0), abs=3e-4)
    assert pair.step == pytest.approx(0.02, abs=0.005)
    assert found.method == "tilt"
    left = left_after(steps, found.corrections)
    assert np.median(np.abs(left)) < 0.01 < np.median(np.abs(steps.step))


def test_a_chain_of_four_lines():
    offsets = (0.0, 0.05, -0.03, 0.02)
    found, _ = compared(strips([constant(value) for value in offsets], overlap=0.4))
    assert [pair.lines for pair in found.pairs] == [(1, 2), (2, 3), (3, 4)]
    assert [pair.step for pair in found.pairs] == pytest.approx(np.diff(offsets), abs=0.005)
    taken = [own.offset for own in found.corrections]
    assert taken == pytest.approx(np.array(offsets) - np.mean(offsets), abs=0.006)


@pytest.mark.parametrize("errors", [[constant(0.0)], [constant(0.0), constant(0.0)]])
def test_nothing_is_taken_off_where_nothing_is_wrong(errors):
    found, _ = compared(strips(errors))
    assert found.corrections == ()
    assert found.lines == len(errors)
    assert found.largest < 0.005
    assert describe_lines(found, "report") == describe_lines(found, "on") == ""


def test_waves_of_a_bad_boresight_are_told_and_not_made_worse():
    found, steps = compared(strips([constant(0.0), lambda x, y: 0.1 * np.sin(y / 5) + 0 * x]))
    before, left = np.abs(steps.step), np.abs(left_after(steps, found.corrections))
    assert np.median(left) <= 1.02 * np.median(before)
    assert found.pairs[0].spread > 0.04


def test_heights_that_are_metres_apart_are_told_and_left_alone():
    found, _ = compared(strips([constant(0.0), constant(30.0)]))
    assert found.pairs[0].step == pytest.approx(30.0, abs=0.01)
    assert found.corrections == ()
    assert "Neither an offset nor a tilt" in describe_lines(found, "report")


def test_only_ground_is_compared_where_the_survey_is_classified():
    points = strips([constant(0.0), constant(0.04)], density=40)
    rng = np.random.default_rng(1)
    wood = rng.random(len(points.x)) < 0.5
    higher = points._replace(z=points.z + wood * (8.0 + 0.5 * points.line), kind=(~wood).astype(np.uint8))
    found, _ = compared(higher)
    assert abs(found.pairs[0].step - 0.04) < 0.005


def test_the_record_comes_back_and_the_text_names_the_lines():
    points = strips([constant(0.0), constant(0.04)])
    found, _ = compared(points)
    taken = FlightLines(2, (), "offset", found.corrections, found.pairs)
    for own in (found, taken):
        assert FlightLines.from_record(json.loads(json.dumps(own.to_record()))) == own
    assert "heights of 1 and 2 differ by 4." in describe_lines(found, "report")
    assert "`align='on'` takes an offset of each line off" in describe_lines(found, "report")
    assert "differed by up to 4." in describe_lines(taken, "on")
