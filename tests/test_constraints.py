"""The pinned versions install on every Python that the package names, also the oldest: a system's own may be that."""

from importlib.metadata import distributions
from pathlib import Path

from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

OLDEST = "3.11.0"
PINS = Path(__file__).resolve().parents[1] / ".ci" / "constraints.txt"


def test_no_pin_wants_a_newer_python_than_the_package():
    lines = [line.partition("==") for line in PINS.read_text(encoding="utf-8").splitlines() if "==" in line]
    pins = {canonicalize_name(name): version for name, _, version in lines}
    held = {
        one.name: one.metadata.get("Requires-Python")
        for one in distributions()
        if pins.get(canonicalize_name(one.name)) == one.version.partition("+")[0]
    }
    assert len(held) > 20
    assert {name: wants for name, wants in held.items() if wants and not SpecifierSet(wants).contains(OLDEST)} == {}
