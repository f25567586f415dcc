"""What an install brings is under licences that go with Apache-2.0, and the page lists it."""

import csv
import importlib.util
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]
_SPEC = importlib.util.spec_from_file_location("list_licences", ROOT / "docs" / "licences" / "list_licences.py")
licences = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(licences)


def listed():
    """Families of licences in the table of the page, by package."""
    with licences.TABLE.open(encoding="utf-8", newline="") as file:
        return {row["package"]: set(row["licence"].split(", ")) for row in csv.DictReader(file)}


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


def test_the_page_lists_every_package_with_a_licence_that_it_has():
    rows = listed()
    for extra in ([], *([name] for name in licences.extras())):
        for name, licence in licences.needed(extra).items():
            assert name in rows, f"run: python docs/licences/list_licences.py --write ({name} is not listed)"
            assert licence is None or rows[name] & set(licence.families), f"{name} is under {licence.said}"


def test_the_page_lists_nothing_else():
    text = (ROOT / ".ci" / "constraints.txt").read_text(encoding="utf-8")
    names = {licences.canonicalize_name(line.split("==")[0]) for line in text.splitlines() if "==" in line}
    assert set(listed()) <= names


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
