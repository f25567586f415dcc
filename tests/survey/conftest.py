import pytest

from bumpymap.survey import Budget


@pytest.fixture
def limit_points(monkeypatch):
    """Function that limits the points of a chunk, of a block, and of those that wait in memory."""

    def limit(**most):
        for name, points in most.items():
            monkeypatch.setattr(Budget, f"{name}_points", points)

    return limit
