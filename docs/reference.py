"""Fill the reference from the declarations in the code, when the pages are built (a hook of MkDocs).

``<!-- help NAME -->`` becomes the help page of a command, ``<!-- settings NAME -->`` its settings file,
``<!-- bands -->`` the bands of roughness.tif, ``<!-- columns FILE -->`` the columns of a Parquet file,
``<!-- profile -->`` the keys of a vehicle profile, ``<!-- vehicles -->`` their values for the included vehicles, and
``<!-- include FILE -->`` what a file under docs/ says, which a command writes: Markdown, or a table in CSV.
"""

import csv
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pyarrow as pa
from click.testing import CliRunner

from bumpymap.cli import main
from bumpymap.core import BANDS
from bumpymap.layers.scan_folder import sector_schema
from bumpymap.layers.tile_table import tile_fields
from bumpymap.rating import KEYS, Vehicle, flat_profile, shipped_profiles


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return a page with its markers replaced."""
    kinds = "help|settings|bands|columns|profile|vehicles|include"
    return re.sub(rf"^<!-- ({kinds})(?: ([a-z_./ ]+))? -->$", _filled, markdown, flags=re.MULTILINE)


def _filled(marker: re.Match[str]) -> str:
    """Return what a marker stands for: a block with what a command prints, or a table."""
    kind, name = marker.groups()
    if kind == "bands":
        rows = ((str(number), f"`{band.name}`", band.unit, band.description) for number, band in enumerate(BANDS, 1))
        return _table(("band", "name", "unit", "content"), rows)
    if kind == "profile":
        rules = [(key.name, key.setting) for key in KEYS]
        rows = ((f"`{key}`", rule.unit, f"{rule.low:g} to {rule.high:g}", rule.help) for key, rule in rules)
        return _table(("key", "unit", "allowed", "meaning"), rows)
    if kind == "vehicles":
        profiles = [flat_profile(Vehicle.load(vehicle).to_dict()) for vehicle in shipped_profiles()]
        rows = ((f"`{key.name}`", *(_plain(profile[key.name]) for profile in profiles)) for key in KEYS)
        return _table(("key", *(f"`{vehicle}`" for vehicle in shipped_profiles())), rows)
    if kind == "include":
        return _included(Path(__file__).parent / name)
    if kind == "columns":
        return _columns(sector_schema() if name == "sectors.parquet" else tile_fields(15))
    words = [*name.split(), "--help"] if kind == "help" else ["settings", *name.split()]
    printed = CliRunner().invoke(main, words, prog_name="bumpymap")
    if printed.exit_code:
        raise ValueError(f"{marker[0]}: {printed.output}")
    return f"```{'text' if kind == 'help' else 'toml'}\n{printed.stdout.strip()}\n```"


def _included(path: Path) -> str:
    """Return the text of a file, or the table of a CSV file."""
    with path.open(encoding="utf-8", newline="") as file:
        if path.suffix != ".csv":
            return file.read().strip()
        head, *cells = csv.reader(file)
        return _table(tuple(head), map(tuple, cells))


def _columns(fields: Iterable[pa.Field]) -> str:
    """Return the table of the columns of a Parquet file."""
    rows = (
        (f"`{field.name}`", _type(field.type), notes.get(b"unit", b"").decode(), notes[b"description"].decode())
        for field in fields
        for notes in [field.metadata]
    )
    return _table(("column", "type", "unit", "content"), rows)


def _plain(value: float | list[float]) -> str:
    return ", ".join(f"{number:g}" for number in (value if isinstance(value, list) else [value]))


def _type(kind: pa.DataType) -> str:
    """Return the name of a type in few words."""
    if pa.types.is_struct(kind):
        return "struct of " + ", ".join(f"`{kind.field(number).name}`" for number in range(kind.num_fields))
    return f"{kind.list_size} x {kind.value_type}" if pa.types.is_fixed_size_list(kind) else str(kind)


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = (head, ("---",) * len(head), *rows)
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)
