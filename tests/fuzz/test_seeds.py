"""What the fuzzer found stays mended: every kept input is read, or refused with one message."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))
from fuzz_readers import SEEDS, Judge

pytestmark = pytest.mark.later


@pytest.fixture(scope="module")
def judge(tmp_path_factory):
    made = Judge(tmp_path_factory.mktemp("seeds"))
    yield made
    made.close()


@pytest.mark.parametrize("seed", sorted(SEEDS.iterdir()), ids=lambda seed: seed.name)
def test_seed(judge, seed):
    verdict = judge.verdict(seed.name, seed.read_bytes())
    assert not verdict.is_fault, verdict.where
