"""What the fuzzer found stays mended: every kept input is read, or refused with one message."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))
from trial import Judge

pytestmark = pytest.mark.later

SEEDS = sorted((Path(__file__).parent / "seeds").iterdir())


@pytest.fixture(scope="module")
def judge(tmp_path_factory):
    made = Judge(tmp_path_factory.mktemp("seeds"))
    yield made
    made.close()


@pytest.mark.parametrize("seed", SEEDS, ids=lambda seed: seed.name)
def test_seed(judge, seed):
    verdict = judge.verdict(seed.name, seed.read_bytes())
    assert not verdict.is_fault, verdict.where
