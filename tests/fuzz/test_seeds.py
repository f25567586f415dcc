"""What the fuzzer found stays mended: every kept input is read, or refused with one message."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.later

HERE = Path(__file__).parent
SEEDS = sorted(path.name for path in (HERE / "seeds").iterdir())
KNOWN: dict[str, str] = {}
"""Faults that are known: name of the seed to what is wrong. A fault that is mended must leave this list."""


@pytest.fixture(scope="module")
def verdicts():
    """Verdicts of all seeds. From a process of its own: one with threads must not fork."""
    command = [sys.executable, str(HERE / "fuzz_readers.py"), "--replay"]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode in {0, 1}, ran.stderr
    return json.loads(ran.stdout)


def marks(name):
    return [pytest.mark.xfail(reason=KNOWN[name], strict=True)] if name in KNOWN else []


@pytest.mark.parametrize("name", [pytest.param(name, marks=marks(name)) for name in SEEDS])
def test_seed(verdicts, name):
    kind, where = verdicts[name]
    assert kind in {"read", "refused"}, where


def test_the_seeds_hold_both_kinds(verdicts):
    assert {"read", "refused"} <= {kind for kind, _ in verdicts.values()}


def test_known_faults_are_those_of_seeds_that_are_there():
    assert set(KNOWN) <= set(SEEDS)
