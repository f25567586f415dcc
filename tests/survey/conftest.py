import shutil

import pytest
from small_surveys import run

from bumpymap.survey import Budget


@pytest.fixture(scope="session")
def killed_at():
    """Function that maps until a place of bumpymap is reached, and leaves in a folder what a kill then leaves."""

    def stop_at(place, left, *words):
        out = left.with_name(f"{left.name} killed")

        def killed(*_, **__):
            shutil.copytree(out, left)
            raise KeyboardInterrupt

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(f"bumpymap.{place}", killed)
            run("map", *words, "--out", out, code=130)

    return stop_at


@pytest.fixture
def limit_points(monkeypatch):
    """Function that limits the points of a chunk, of a block, and of those that wait in memory."""

    def limit(**most):
        for name, points in most.items():
            monkeypatch.setattr(Budget, f"{name}_points", points)

    return limit
