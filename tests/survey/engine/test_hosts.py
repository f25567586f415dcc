"""Two hosts that share one folder, of which one is lost: the same bytes. See ``tests/benchmarks/hosts.py``."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.namespaces
@pytest.mark.skipif(not all(map(shutil.which, ("ip", "nsenter", "openssl"))), reason="needs ip, nsenter and openssl")
def test_a_host_that_is_lost_changes_no_byte(tmp_path):
    pytest.importorskip("distributed")
    before = subprocess.run(["ip", "netns", "list"], capture_output=True, check=True).stdout
    script, survey = ROOT / "tests" / "benchmarks" / "hosts.py", ROOT / "sample_data" / "quarry.laz"
    for number in range(4):
        shutil.copy(survey, tmp_path / f"{number}.laz")
    command = [sys.executable, script, *sorted(tmp_path.glob("*.laz")), "--data", tmp_path, "--saved", "0"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=180, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "files, the same" in ended.stdout
    assert "gather" not in ended.stdout  # dask reports nothing itself
    assert subprocess.run(["ip", "netns", "list"], capture_output=True, check=True).stdout == before
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{number}.laz" for number in range(4)]
