"""What of a survey was never classified, and what only looks like it: roofs, woods, water."""

import numpy as np
import pytest

from bumpymap.readers import BLANK, GROUND, UnclassifiedPart

SIDE = 64
"""Tiles along the survey: 192 m."""
EAST = np.s_[:, 32:]


def found(blank, lowest, *, empty=()):
    """Tiles that count as never classified, of (64, 64), where those of ``blank`` hold only points of class 0 or 1."""
    marks = np.full((SIDE, SIDE), GROUND, np.uint8)
    for place in blank:
        marks[place] = BLANK
    for place in empty:
        marks[place] = 0
    row, col = (index.reshape(-1) for index in np.indices(marks.shape))
    blocks = {(r, c): marks[16 * r : 16 * r + 16, 16 * c : 16 * c + 16].reshape(-1) for r in range(4) for c in range(4)}
    blocks = {key: own for key, own in blocks.items() if own.any()}
    part = UnclassifiedPart.find(blocks, 3.0)
    out = np.zeros(marks.shape, bool)
    if part is not None:
        whole = part.never_classified([(row, col, lowest.reshape(-1), of_ground) for of_ground in (True, False)])
        north, east = np.nonzero(whole)
        out[north + part.south, east + part.west] = True
    return out


def ground(slope=0.0):
    """Lowest points on a plane that rises to the east, with stones and hollows."""
    rng = np.random.default_rng(2)
    return 3.0 * slope * np.arange(SIDE) + rng.uniform(-0.1, 0.1, (SIDE, SIDE))


@pytest.mark.parametrize("slope", [0.0, 0.6])
def test_a_half_whose_ground_goes_on_was_never_classified(slope):
    out = found([EAST], ground(slope))
    assert out[EAST].all()
    assert not out[:, :32].any()


def test_a_corner_and_a_strip_across_the_survey_may_be_such_parts_too():
    for place in (np.s_[40:, 40:], np.s_[:, 20:40]):
        out = found([place], ground())
        assert out[place].all()
        assert out.sum() == out[place].sum()


def test_a_part_that_lies_apart_from_classified_ground_was_never_classified():
    out = found([EAST], ground() + 50.0 * (np.arange(SIDE) > 31), empty=[np.s_[:, 28:36]])
    assert out[:, 36:].all()


@pytest.mark.parametrize(
    ("place", "height"),
    [
        pytest.param(np.s_[20:27, 20:27], 0.0, id="a pond of 21 m"),
        pytest.param(np.s_[20:27, 57:], 6.0, id="a roof of 21 m at the edge"),
        pytest.param(np.s_[12:50, 12:50], 0.0, id="a lake amid the survey"),
        pytest.param(np.s_[10:40, 40:], 8.0, id="a hall at the edge"),
        pytest.param(np.s_[:, 30:], 4.0, id="a wood that is half of the survey"),
        pytest.param(np.s_[:, 60:], 0.0, id="a strip along the edge"),
    ],
)
def test_what_stands_in_classified_ground_is_not_ground(place, height):
    lowest = ground()
    lowest[place] += height
    assert not found([place], lowest).any()


def test_a_hall_beside_the_border_is_none_of_the_part():
    lowest, hall = ground(), np.s_[20:34, 14:32]
    lowest[hall] += 7.0
    out = found([EAST, hall], lowest)
    assert not out[20:34, 14:28].any()
    assert out[:14, 33:].all()
    assert out[:, 33:].mean() > 0.8
