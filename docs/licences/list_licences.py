"""List what the default install and each extra bring, with the licences: the table of docs/pages/licences.md.

    python docs/licences/list_licences.py            # prints the table for what is installed here
    python docs/licences/list_licences.py --write    # writes the file anew

The requirements of bumpymap itself are read from pyproject.toml, those of all others from what pip installed.
"""

import argparse
import csv
import io
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
TABLE = Path(__file__).with_name("licences.csv")
_OWN = "bumpymap"
_FAMILIES = {
    "AGPL": r"agpl|affero",
    "LGPL": r"lgpl|(lesser|library) general public",
    "GPL": r"(?<![al])gpl|(?<!lesser )(?<!library )(?<!affero )general public licen",
    "Apache-2.0": r"apache",
    "BSD": r"bsd",
    "MIT": r"\bmit\b",
    "PSF-2.0": r"\bpsf\b|python software foundation",
    "MPL-2.0": r"\bmpl\b|mozilla public",
    "ISC": r"\bisc\b",
    "Zlib": r"zlib",
    "BSL-1.0": r"\bbsl-1|boost software",
    "CC0-1.0": r"cc0",
    "any OSI": r"\bany[- ]osi\b",
}
"""Family of licences: what its names look like, in lower case."""
REFUSED = ("AGPL", "LGPL", "GPL")
_GPU_LIBRARIES = re.compile(r"(nvidia|cuda)-")
"""Names that builds of torch for GPUs need and its builds for the CPU, which bumpymap takes, do not."""


@dataclass(frozen=True, slots=True)
class Licence:
    """Licence that a package states."""

    families: tuple[str, ...]
    """Empty: nobody can tell."""
    said: str

    @property
    def refused(self) -> bool:
        """True if a package under Apache-2.0 should not lean on it; a choice between licences may leave it out."""
        return any(family in REFUSED for family in self.families)


def families_of(text: str) -> tuple[str, ...]:
    """Families that are named in a text, in the order of the table of families."""
    lower = text.lower()
    return tuple(family for family, pattern in _FAMILIES.items() if re.search(pattern, lower))


def licence_of(metadata: Mapping[str, object], classifiers: Iterable[str]) -> Licence:
    """Read the licence of a package: its SPDX expression, else its classifiers, else the first line of its licence.

    ``OR`` in an expression is a choice: the parts that may not be used are left out where another one is there.
    """
    expression = str(metadata.get("License-Expression") or "")
    if expression:
        choices = [families_of(part) for part in re.split(r"\bOR\b", expression)]
        allowed = [choice for choice in choices if choice and not set(choice) & set(REFUSED)]
        found = {family for choice in allowed or choices for family in choice}
        return Licence(tuple(family for family in _FAMILIES if family in found), expression)
    said = " / ".join(line.rpartition("::")[2].strip() for line in classifiers if line.startswith("License ::"))
    if not families_of(said):
        said = next(iter(str(metadata.get("License") or "").strip().splitlines()), "")
    return Licence(families_of(said), said)


def needed(extras: Iterable[str] = ()) -> dict[str, Licence | None]:
    """Find the packages that an install of bumpymap brings here, and their licences; None: not installed."""
    found: dict[str, Licence | None] = {}
    waiting, seen = [(_OWN, frozenset(extras))], set()
    while waiting:
        item = waiting.pop()
        if item in seen:
            continue
        seen.add(item)
        name, wanted = item
        for requirement in _requirements(name, found):
            marker = requirement.marker
            if marker is None or any(marker.evaluate({"extra": extra}) for extra in wanted or {""}):
                waiting.append((canonicalize_name(requirement.name), frozenset(requirement.extras)))
    return dict(sorted(found.items()))


def extras() -> list[str]:
    """Names of the extras, without ``all``."""
    return sorted(set(_project()["optional-dependencies"]) - {"all"})


def table() -> str:
    """Make the table for what is installed: one row a package, with the extras that bring it."""
    default = needed()
    brought: dict[str, list[str]] = {name: ["default"] for name in default}
    licences = dict(default)
    for extra in extras():
        for name, licence in needed([extra]).items():
            licences[name] = licence
            if name not in default:
                brought.setdefault(name, []).append(f"`{extra}`")
    text = io.StringIO()
    rows = [(name, _shown(licences[name]), ", ".join(brought[name])) for name in sorted(licences)]
    csv.writer(text, lineterminator="\n").writerows([("package", "licence", "comes with"), *rows])
    return text.getvalue()


def _project() -> dict[str, dict[str, list[str]]]:
    project: dict[str, dict[str, list[str]]] = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    return project


def _requirements(name: str, found: dict[str, Licence | None]) -> list[Requirement]:
    """List the requirements of a package, and note its licence."""
    if name == _OWN:
        own = [Requirement(line) for line in _project()["dependencies"]]
        for extra, lines in _project()["optional-dependencies"].items():
            own += [Requirement(f'{line}; extra == "{extra}"') for line in lines]
        return own
    try:
        installed = distribution(name)
    except PackageNotFoundError:
        found[name] = None
        return []
    found[name] = licence_of(installed.metadata, installed.metadata.get_all("Classifier") or [])
    requirements = [Requirement(line) for line in installed.requires or []]
    return [one for one in requirements if not _GPU_LIBRARIES.match(one.name)]


def _shown(licence: Licence | None) -> str:
    return "not installed here" if licence is None else ", ".join(licence.families) or f"unknown ({licence.said})"


def main() -> None:
    """Print the table, or write it."""
    parser = argparse.ArgumentParser(description="List the licences of what bumpymap needs.")
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.name}")
    if not parser.parse_args().write:
        print(table(), end="")
        return
    TABLE.write_text(table(), "utf-8")


if __name__ == "__main__":
    main()
