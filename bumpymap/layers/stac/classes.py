"""The values of the rasters that hold codes, as the classification extension of STAC lists them."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from bumpymap.core import BARRED_TEXT, CLASS_NAMES, NO_CLASS, OBJECT_NAMES, REASON_TEXT
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS, OBJECT_COLOURS, REASON_COLOURS

__all__ = ["classes_of_band"]

_Colours = Mapping[int, tuple[int, int, int, int]]
_TABLES: dict[str, tuple[dict[int, str], _Colours]] = {
    "class": (dict(enumerate(CLASS_NAMES)), CLASS_COLOURS),
    "reason": ({int(code): text for code, text in REASON_TEXT.items()}, REASON_COLOURS),
    "barred": ({int(code): text for code, text in BARRED_TEXT.items()}, BARRED_COLOURS),
    "obstacle": (dict(enumerate(OBJECT_NAMES)), OBJECT_COLOURS),
}


def classes_of_band(band: str, limits: Sequence[float] = ()) -> list[dict[str, Any]] | None:
    """Return the entries of ``classification:classes`` of a band of codes; None: the band holds none.

    Parameters
    ----------
    band : str
        Its name.
    limits : sequence of float, optional
        Ride costs between the classes, rad/m, if the classes of the map were made by them.
    """
    if band not in _TABLES:
        return None
    names, colours = _TABLES[band]
    meanings = _intervals(limits) if band == "class" and len(limits) == len(names) - 1 else []
    found = []
    for value, name in names.items():
        entry: dict[str, Any] = {"value": value, "name": name.replace(" ", "_"), "title": name}
        if meanings:
            entry["description"] = meanings[value]
        red, green, blue, alpha = colours[value]
        if alpha:
            entry["color_hint"] = f"{red:02X}{green:02X}{blue:02X}"
        found.append(entry)
    return [*found, {"value": NO_CLASS, "name": "nodata", "title": "no data", "nodata": True}]


def _intervals(limits: Sequence[float]) -> list[str]:
    """Return the ride costs of each class in words."""
    edges = [f"{limit:g}" for limit in limits]
    middle = [f"{low} to {high}" for low, high in pairwise(edges)]
    return [f"c_r {span} rad/m" for span in (f"below {edges[0]}", *middle, f"from {edges[-1]}")]
