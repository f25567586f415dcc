"""Write catalog.json: a STAC catalogue of many maps."""

import re
from collections.abc import Sequence
from os.path import lexists
from pathlib import Path
from typing import Any
from urllib.parse import quote

from bumpymap.core import OutputError
from bumpymap.layers.manifest import MANIFEST_NAME
from bumpymap.layers.products import CATALOG_NAME, ITEM_NAME
from bumpymap.layers.stac.document import STAC_VERSION, identifier, valid_text, write_document

__all__ = ["write_catalog"]

_ESCAPED = re.compile("[#?%\\x00-\\x1f\ud800-\udfff]")
"""Characters that a link cannot hold: surrogates stand for bytes of a file name that are not UTF-8."""


def write_catalog(root: Path, folders: Sequence[str], *, title: str) -> None:
    """Write catalog.json: a STAC catalogue with a link to the item of each complete map, or to its own catalogue.

    A map in sheets has a catalogue with an item for each sheet.

    Items do not link back: they are the same whether a map was made alone or with others.

    Parameters
    ----------
    root : Path
        The folder that holds those of the maps.
    folders : sequence of str
        Their names in it, in the order of the links. One without a complete map is left out.
    title : str
        Of the catalogue.

    Raises
    ------
    OutputError
        The file cannot be written, or there is a link or a folder in its place.
    """
    place = root / CATALOG_NAME
    if lexists(place) and (place.is_symlink() or not place.is_file()):
        raise OutputError(f"{place} is a link or no file, and was not touched. Remove it")
    items = [_link("item", f"./{_quoted(name)}/{ITEM_NAME}", name) for name in folders if _has(root / name, ITEM_NAME)]
    children = [
        _link("child", f"./{_quoted(name)}/{CATALOG_NAME}", name) | {"type": "application/json"}
        for name in folders
        if _has(root / name, CATALOG_NAME) and not _has(root / name, ITEM_NAME)
    ]
    name = valid_text(title)
    document = {
        "type": "Catalog",
        "stac_version": STAC_VERSION,
        "id": identifier(name),
        "title": name,
        "description": "Roughness and ride cost of the ground, from point clouds: one item for each survey or sheet",
        "links": [_link("root", f"./{CATALOG_NAME}", title) | {"type": "application/json"}, *items, *children],
    }
    write_document(document, place)


def _has(folder: Path, name: str) -> bool:
    return (folder / name).is_file() and (folder / MANIFEST_NAME).is_file()


def _quoted(name: str) -> str:
    """Return the name of a folder as a part of a relative link; only what would end or change the link is escaped.

    pystac opens links as they are written, so that the others must stay.
    """
    return "".join(quote(one, safe="", errors="surrogateescape") if _ESCAPED.match(one) else one for one in name)


def _link(rel: str, href: str, title: str) -> dict[str, Any]:
    return {"rel": rel, "href": href, "type": "application/geo+json", "title": valid_text(title)}
