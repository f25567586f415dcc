"""The pinned versions install on every Python that the package names, and every file is held against its hash."""

import re
import subprocess
import sys
from hashlib import sha256
from importlib.metadata import distributions
from pathlib import Path
from zipfile import ZipFile

import pytest
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

OLDEST = "3.11.0"
CI = Path(__file__).resolve().parents[1] / ".ci"


def pins(file):
    lines = [line for line in (CI / file).read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return dict(line.split(" ")[0].split("==") for line in lines)


def test_no_pin_wants_a_newer_python_than_the_package():
    pinned = {canonicalize_name(name): version for name, version in pins("constraints.txt").items()}
    held = {
        one.name: one.metadata.get("Requires-Python")
        for one in distributions()
        if pinned.get(canonicalize_name(one.name)) == one.version.partition("+")[0]
    }
    assert len(held) > 20
    assert {name: wants for name, wants in held.items() if wants and not SpecifierSet(wants).contains(OLDEST)} == {}


def test_every_pin_has_hashes_and_no_index_is_named():
    assert pins("hashes.txt") == pins("constraints.txt")
    lines = [line for line in (CI / "hashes.txt").read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    assert [line for line in lines if not re.fullmatch(r"\S+==\S+( --hash=sha256:[0-9a-f]{64})+", line)] == []


@pytest.mark.slow
@pytest.mark.parametrize("right", [True, False])
def test_the_pinned_pip_holds_a_file_against_the_hash_of_its_constraint(tmp_path, right):
    wheel, info = tmp_path / "probe-1-py3-none-any.whl", "probe-1.dist-info"
    with ZipFile(wheel, "w") as archive:
        archive.writestr(f"{info}/METADATA", "Metadata-Version: 2.1\nName: probe\nVersion: 1\n")
        archive.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr(f"{info}/RECORD", "")
    digest = sha256(wheel.read_bytes()).hexdigest() if right else "0" * 64
    (tmp_path / "hashes.txt").write_text(f"probe==1 --hash=sha256:{digest}\n", encoding="utf-8")
    held = ["--require-hashes", "--constraint", "hashes.txt", "--no-index", "--find-links", ".", "probe>=1"]
    said = subprocess.run(
        [sys.executable, "-m", "pip", "--isolated", "install", "--dry-run", "--no-cache-dir", *held],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (said.returncode == 0) is right, said.stderr
    assert right or "DO NOT MATCH THE HASHES" in said.stderr
