"""What the fuzzer found stays mended: every kept input is read, or refused with one message."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.later

HERE = Path(__file__).parent
SEEDS = sorted(path.name for path in (HERE / "seeds").iterdir())


@pytest.fixture(scope="module")
def verdicts():
    """Verdicts of all seeds."""
    command = [sys.executable, str(HERE / "fuzz_readers.py"), "--replay"]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode in {0, 1}, ran.stderr
    return json.loads(ran.stdout)


@pytest.mark.parametrize("name", SEEDS)
def test_seed(verdicts, name):
    kind, where = verdicts[name]
    assert kind in {"read", "refused"}, where


def test_the_seeds_hold_both_kinds(verdicts):
    assert {"read", "refused"} <= {kind for kind, _ in verdicts.values()}
