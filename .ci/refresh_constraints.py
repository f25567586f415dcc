"""Write the versions of the environment that runs this to constraints.txt, the sha256 of their wheels to hashes.txt.

    .venv/bin/python .ci/refresh_constraints.py

A build of this machine's own (2.13.0+cpu) stands for its version: what the index has of it, and what that needs, is
written too.
"""

import json
import subprocess
import sys
from hashlib import sha256
from optparse import Values
from pathlib import Path

from pip._internal.commands.index import IndexCommand
from pip._internal.models.link import Link
from pip._internal.models.target_python import TargetPython
from pip._vendor.packaging.tags import Tag, compatible_tags, cpython_tags

HERE = Path(__file__).resolve().parent
PYTHONS = [(3, 11), (3, 12), (3, 13), (3, 14)]
PLATFORMS = [
    f"{kind}_{machine}"
    for machine in ("x86_64", "aarch64")
    for kind in (*(f"manylinux_2_{minor}" for minor in range(5, 40)), "manylinux1", "manylinux2010", "manylinux2014")
]
VERSIONS_HEAD = (
    "# Versions that the suite passes with. Made by .ci/refresh_constraints.py from a working environment.\n"
)
HASHES_HEAD = """\
# sha256 of the wheels of the versions in constraints.txt, for CPython 3.11 to 3.14 on Linux (glibc; x86-64 and ARM64),
# where there are any. A version with a local build (torch's for the CPU alone) has the sha256 of that too. Made by
# .ci/refresh_constraints.py.
"""


def pip(*arguments: str) -> str:
    """Run pip in this environment and return what it prints."""
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", *arguments]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout  # noqa: S603


def pinned() -> dict[str, str]:
    """Return the version of each package here, and of those that the index's files of the same versions need."""
    frozen = [line.split("==") for line in pip("freeze", "--all", "--exclude", "bumpymap").splitlines() if "==" in line]
    pins = {name: version.partition("+")[0] for name, version in frozen}
    others = [f"{name}=={pins[name]},!={version}" for name, version in frozen if version != pins[name]]
    if others:
        write_versions(pins)
        limits = ("--constraint", str(HERE / "constraints.txt"), "--ignore-installed")
        report = pip("install", "--quiet", "--dry-run", "--report", "-", *limits, *others)
        for one in json.loads(report)["install"]:
            pins.setdefault(one["metadata"]["name"], one["metadata"]["version"])
    return pins


def write_versions(pins: dict[str, str]) -> None:
    """Write ``constraints.txt``."""
    lines = sorted((f"{name}=={version}\n" for name, version in pins.items()), key=str.casefold)
    (HERE / "constraints.txt").write_text(VERSIONS_HEAD + "".join(lines), encoding="utf-8")


TAGS = {
    tag
    for python in PYTHONS
    for tag in (
        *cpython_tags(python, platforms=PLATFORMS),
        *compatible_tags(python, "cp{}{}".format(*python), PLATFORMS),
    )
}


class _AnyTarget(TargetPython):
    """All Pythons and platforms at once."""

    def get_unsorted_tags(self) -> set[Tag]:
        return TAGS


class _Hashes(IndexCommand):
    """pip's command for what an index has, with pip's own settings: it writes ``hashes.txt``."""

    def run(self, options: Values, args: list[str]) -> int:
        with self._build_session(options) as session:
            finder = self._build_package_finder(options, session, _AnyTarget(py_version_info=PYTHONS[0]))
            lines = []
            for pin in args:
                name, _, version = pin.partition("==")
                links = [one.link for one in finder.find_all_candidates(name) if one.version.public == version]
                found = sorted({digest(link) for link in links if link.is_wheel})
                lines.append(" ".join((pin, *(f"--hash=sha256:{one}" for one in found))) + "\n")
        (HERE / "hashes.txt").write_text(HASHES_HEAD + "".join(lines), encoding="utf-8")
        return 0


def digest(link: Link) -> str:
    """Return the sha256 of a file: the index's word, or that of a local file."""
    return link.hash if link.hash_name == "sha256" else sha256(Path(link.file_path).read_bytes()).hexdigest()


def main(pins: dict[str, str]) -> int:
    """Write both files; the result is the exit status."""
    write_versions(pins)
    lines = sorted((f"{name}=={version}" for name, version in pins.items()), key=str.casefold)
    return _Hashes("hashes", "").main(lines)


if __name__ == "__main__":
    sys.exit(main(pinned()))
