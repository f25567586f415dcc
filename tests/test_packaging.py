"""What an install brings: pinned and hashed versions, their licences, the container and the conda package."""

import csv
import importlib.util
import re
import tomllib
from importlib.metadata import distributions
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
CI = ROOT / ".ci"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
CONDA = {"lazrs": "lazrs-python", "lazy-loader": "lazy_loader"}
"""Packages that have another name on conda-forge."""


def test_the_conda_package_needs_what_the_wheel_needs():
    recipe = yaml.safe_load((CI / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    wanted = {f"python {PROJECT['project']['requires-python']}"}
    for line in PROJECT["project"]["dependencies"]:
        one = Requirement(line)
        wanted.add(f"{CONDA.get(one.name, one.name)} {one.specifier}")
        wanted |= {CONDA.get(extra, extra) for extra in one.extras}  # conda has no extras: laspy[lazrs] is two packages
    assert set(recipe["requirements"]["run"]) == wanted
    assert PROJECT["build-system"]["requires"] == [
        line.replace(" ", "") for line in recipe["requirements"]["host"][-2:]
    ]


def test_the_container_copies_what_the_wheel_is_built_from():
    containerfile = (ROOT / "Containerfile").read_text(encoding="utf-8")
    copied = " ".join(re.findall(r"^COPY (?!--from)(.*) \S+$", containerfile, re.MULTILINE)).split()
    assert all((ROOT / name).exists() for name in copied)
    own = PROJECT["project"]
    wheel = PROJECT["tool"]["scikit-build"]["wheel"]
    assert {"pyproject.toml", own["readme"], *own["license-files"], ".ci/hashes.txt", ".ci/install"} <= set(copied)
    assert {package.split("/")[0] for package in wheel["packages"]} <= set(copied)
    sample = re.search(r"sample_data/\S+\.laz", (ROOT / "tiles" / "CMakeLists.txt").read_text(encoding="utf-8"))
    assert sample[0] in copied


# --- the pinned versions install on every Python that the package names, and every file is held against its hash ---
def lines_of(file):
    return [line for line in (CI / file).read_text(encoding="utf-8").splitlines() if not line.startswith("#")]


def pins(file):
    return dict(line.split(" ")[0].split("==") for line in lines_of(file))


def test_no_pin_wants_a_newer_python_than_the_package():
    pinned = {canonicalize_name(name): version for name, version in pins("constraints.txt").items()}
    held = {
        one.name: one.metadata.get("Requires-Python")
        for one in distributions()
        if pinned.get(canonicalize_name(one.name)) == one.version.partition("+")[0]
    }
    assert len(held) > 20
    assert {name: wants for name, wants in held.items() if wants and not SpecifierSet(wants).contains("3.11.0")} == {}


def test_every_pin_has_hashes_that_are_required_and_no_index_is_named():
    for file, held in ((CI / "install", "$here/hashes.txt"), (ROOT / "Makefile", ".ci/hashes.txt")):
        assert f"--require-hashes --constraint {held}" in file.read_text(encoding="utf-8")
    assert pins("hashes.txt") == pins("constraints.txt")
    hashed = r"\S+==\S+( --hash=sha256:[0-9a-f]{64})+"
    assert [line for line in lines_of("hashes.txt") if not re.fullmatch(hashed, line)] == []


# --- what an install brings is under licences that go with Apache-2.0, and the page lists it ---
_SPEC = importlib.util.spec_from_file_location("list_licences", ROOT / "docs" / "licences" / "list_licences.py")
licences = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(licences)


@pytest.mark.slow
@pytest.mark.parametrize("extra", ["default", *licences.extras()])
def test_every_package_says_a_licence_that_goes_with_ours(extra):
    found = licences.needed([] if extra == "default" else [extra])
    assert found
    known = {name: licence for name, licence in found.items() if licence is not None}
    assert {name: licence.said for name, licence in known.items() if not licence.families} == {}
    assert {name: licence.said for name, licence in known.items() if licence.refused} == {}
    missing = set(found) - set(known)
    if missing:
        pytest.skip(f"the licences of all others are fine; not installed here: {', '.join(sorted(missing))}")


@pytest.mark.slow
def test_the_page_lists_every_package_with_a_licence_that_it_has_and_nothing_else():
    with licences.TABLE.open(encoding="utf-8", newline="") as file:
        rows = {row["package"]: set(row["licence"].split(", ")) for row in csv.DictReader(file)}
    for extra in ([], *([name] for name in licences.extras())):
        for name, licence in licences.needed(extra).items():
            assert name in rows, f"run: python docs/licences/list_licences.py --write ({name} is not listed)"
            assert licence is None or rows[name] & set(licence.families), f"{name} is under {licence.said}"
    assert set(rows) <= {canonicalize_name(name) for name in pins("constraints.txt")}


@pytest.mark.parametrize(
    ("expression", "classifier", "text", "families", "refused"),
    [
        ("", "License :: OSI Approved :: GNU General Public License v3 or later (GPLv3+)", "", ("GPL",), True),
        ("GPL-3.0-or-later", "", "MIT", ("GPL",), True),
        ("LGPL-2.1-or-later", "", "", ("LGPL",), True),
        ("", "", "GNU GENERAL PUBLIC LICENSE\n Version 3", ("GPL",), True),
        ("MIT AND GPL-2.0-only", "", "", ("GPL", "MIT"), True),
        ("MIT OR GPL-2.0-only", "", "", ("MIT",), False),
        ("LGPL-3.0-only OR GPL-2.0-only", "", "", ("LGPL", "GPL"), True),
        ("Apache-2.0 WITH LLVM-exception", "", "", ("Apache-2.0",), False),
        ("", "License :: OSI Approved :: MIT License", "GPL", ("MIT",), False),
        ("", "License :: OSI Approved", "BSD 3-Clause License\n\nCopyright", ("BSD",), False),
        ("", "", "", (), False),
        ("", "", "Permission is granted to limited users", (), False),
    ],
)
def test_what_a_package_says_is_understood(expression, classifier, text, families, refused):
    found = licences.licence_of({"License-Expression": expression, "License": text}, [classifier])
    assert (found.families, found.refused) == (families, refused)
