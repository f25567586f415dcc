"""What check.md says of the columns, units and formats is so."""

import re
from pathlib import Path

from bumpymap.readers import parse_columns
from bumpymap.readers.drives.quantities import QUANTITIES, UNITS, guess_columns

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "pages" / "check.md").read_text(encoding="utf-8")
TABLE = [line.split("|") for line in PAGE.split("| quantity | what |")[1].split("\n\n")[0].splitlines()[2:]]
SECOND = {
    "lon": ["lat"],
    "lng": ["lat"],
    "longitude": ["latitude"],
    "easting": ["northing"],
    "east": ["north"],
    "E": ["N"],
    "velL": ["velR"],
    "v_left": ["v_right"],
    "left_speed": ["right_speed"],
    "xgyro": ["ygyro", "zgyro"],
}
"""The other columns of groups that no axis numbers."""


def others(name):
    """Names of the other columns of a group: of ``gyro_x``, those of y, z and w."""
    if name in SECOND:
        return SECOND[name]
    if name.startswith("roll"):
        return [name.replace("roll", each) for each in ("pitch", "yaw")]
    axis = re.search(r"[xX0](?=\]?$)", name)
    return [name[: axis.start()] + each + name[axis.end() :] for each in {"x": "yzw", "X": "YZ", "0": "12"}[axis[0]]]


def test_every_quantity_has_a_row():
    assert sorted(name for row in TABLE for name in re.findall(r"`(\w+)`", row[1])) == sorted(QUANTITIES)


def test_names_on_the_page_are_known():
    tried = 0
    for row in TABLE:
        quantities = re.findall(r"`(\w+)`", row[1])
        for name in re.findall(r"`([^`]+)`", row[3]):
            if name in {"lat", "latitude"}:  # beside lon and longitude
                continue
            columns = [name] if len(quantities) == 1 else [name, *others(name)][: len(quantities)]
            beside = ["stamp.sec", "secs"] if quantities == ["nanosec"] else []
            found = guess_columns("a.csv", [*columns, *beside])
            assert [found[quantity].name for quantity in quantities] == columns
            tried += 1
    assert tried > 45


def test_units_on_the_page_are_those_that_are_known():
    rows = PAGE.split("| quantity | units |")[1].split("\n\n")[0].splitlines()[2:]
    listed = [row.split("|")[2].strip().split(", ") for row in rows]
    assert sorted(map(sorted, listed)) == sorted(sorted(units) for name, units in UNITS.items() if name != "number")


def test_the_examples_of_naming_columns_are_read():
    examples = re.findall(r"--columns ([^\s`]*=[^\s`]*)", PAGE)
    assert len(examples) == 3
    assert all(parse_columns(text) for text in examples)
