"""What a check and the summary of a map say in words."""

from dataclasses import replace

import numpy as np
import pytest
from check_records import made_up_check

from bumpymap.views import check_headline, degrees_line
from bumpymap.views.words import check_verdict


def judged(n=40, **figures):
    result = made_up_check(n)
    return replace(result, agreement=replace(result.agreement, **figures))


@pytest.mark.parametrize(
    ("rank", "ratio", "inside", "words"),
    [
        (0.95, 1.14, 0.79, "The map holds"),
        (0.95, 1.16, 0.79, "The map ranks the ground rightly, but its level is off"),
        (0.95, 0.8, 0.8, "The map ranks the ground rightly, but its level is off by no more than its interval allows"),
        (0.7, 1.0, 0.79, "The map ranks the ground only roughly"),
        (0.7, 2.0, 0.79, "The map ranks the ground only roughly, and its level is off"),
        (-0.9, 1.0, 0.79, "The map does not rank this ground as the vehicle felt it"),
    ],
)
def test_the_verdict_follows_from_rank_and_level(rank, ratio, inside, words):
    assert check_verdict(judged(spearman=rank, median_ratio=ratio, inside=inside)) == words


def test_even_ground_cannot_be_ranked():
    result = judged(spearman=0.1, median_ratio=0.7, inside=0.3)
    even = replace(result.stretches, measured=np.full(40, 0.1))
    words = check_verdict(replace(result, stretches=even))
    assert words == "The map's level is off; the ground driven is too even to say whether the map ranks ground rightly"
    held = replace(result, stretches=even, agreement=replace(result.agreement, median_ratio=1.05))
    assert check_verdict(held).startswith("The level of the map holds; ")


def test_the_headline_holds_the_figures():
    figures = {"spearman": 0.96, "median_ratio": 0.92, "median_error": 0.11, "inside": 0.79, "way_m": 412.3}
    assert check_headline(judged(**figures)) == (
        "The map holds. Over 412 m in 40 stretches it reads 8 % low in the median, and half of the stretches are off "
        "by less than 11 %. 79 % of the drives' readings lie in its 80 % interval."
    )
    few, alone = made_up_check(3), made_up_check(8, ground=False)
    assert check_headline(few).startswith("Too little was driven on the map to judge it: 30 m in 3 stretches.")
    mean = np.mean(alone.stretches.measured)
    assert check_headline(alone) == (
        f"1 drive measured over 80 m: a ride cost of {mean:.3f} rad/m on average. No map was checked."
    )


def test_a_summary_says_ride_costs_in_degrees():
    line = degrees_line([0.1, np.nan, np.radians(20.0), np.nan])
    assert line.startswith("Median c_r in degrees of pitch per metre: smooth 5.7, rough 20.0; ")
    assert line.endswith("measured 2.2 on asphalt, 8.4 on snow, 16.2 on silty loam")
    assert degrees_line([np.nan] * 4) == ""
