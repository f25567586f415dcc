"""A map in sheets is exported as the whole map is, whatever the order of the folders."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from cost_maps import with_objects

from bumpymap.layers import open_map
from bumpymap.views import ExportSettings, export_map


def part_of(record, kept):
    """The same record with some of the tiles."""
    changes = {}
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, np.ndarray):
            changes[field.name] = value[kept]
        elif is_dataclass(value) and field.name in {"patches", "textures", "objects"}:
            changes[field.name] = part_of(value, kept)
    return replace(record, **changes)


@pytest.mark.parametrize(
    ("to", "options"), [("nav2", {"resolution": "pixel"}), ("graph", {"every": 9}), ("gridmap", {"resolution": "tile"})]
)
def test_sheets_are_one_map(make_field, write_map, tmp_path, to, options):
    if to == "gridmap":
        pytest.importorskip("rosbags")
    whole = with_objects(make_field(18, 14, easy=True))
    col = whole.patches.col
    west, east = col < col.min() + 10, col >= col.min() + 8  # two columns are in both
    folders = {"whole": np.full(len(col), True), "west": west, "east": east}
    for name, kept in folders.items():
        write_map(part_of(whole, kept), tmp_path / name)
    files = []
    for number, names in enumerate((["whole"], ["west", "east"], ["east", "west"])):
        site = open_map([tmp_path / name for name in names])
        done = export_map(site, tmp_path / str(number), ExportSettings(to=to, **options))
        assert done.record["layers"] == names
        files.append({path.name: path.read_bytes() for path in done.files if path.name != "datum.json"})
    assert files[0] == files[1] == files[2]
