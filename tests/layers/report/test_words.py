"""Sentences of the page."""

from bumpymap.layers.report.words import _speeds


def test_a_map_at_another_speed_says_at_which_it_was_driven():
    assert _speeds({"speed_mps": 1.0}) == "1.00 m/s"
    assert _speeds({"speed_mps": 1.0, "drives_mps": 1.0}) == "1.00 m/s"
    assert _speeds({"speed_mps": 2.0, "drives_mps": 1.0}) == "1.00 m/s; the ride costs of this map are for 2.00 m/s"
