"""What a run says when no point is left."""

from types import SimpleNamespace

import pytest

from bumpymap.core.errors import BadInputError
from bumpymap.readers import PointStats
from bumpymap.survey.engine.reading import refuse_no_points


@pytest.mark.parametrize(
    ("tallies", "says"),
    [
        ([PointStats(10, withheld=10)], r"of the 10 points of a, 10 are flagged as withheld\. Clear"),
        (
            [PointStats(10, withheld=4, noise=6), PointStats(5, noise=5)],
            r"of the 15 points of a, b, 4 are flagged as withheld and 11 are of class 7 or 18 \(noise\)\. Clear",
        ),
        ([PointStats(1000, not_a_number=1000)], r"of the 1,000 points of a, 1,000 are beams without return\. Is it"),
        ([PointStats(), PointStats()], r"every input was skipped \(a, b\)"),
        ([PointStats()] * 7, r"\(a, b, c, d, e and 2 more\)"),
    ],
)
def test_no_point_left(tallies, says):
    readers = [SimpleNamespace(info=SimpleNamespace(path=name)) for name in "abcdefgh"]
    with pytest.raises(BadInputError, match=says):
        refuse_no_points(readers[: len(tallies)], tallies)
    refuse_no_points(readers[: len(tallies) + 1], [*tallies, PointStats(1)])
