"""Ways that `bumpymap route` found, in the coordinates of a map."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer
from pyproj.exceptions import ProjError

from bumpymap.core import BadInputError, parse_json, read_regular, stated_crs

__all__ = ["DrawnWay", "read_ways"]

_FILE = "route.geojson"
_DECIMALS = 2


@dataclass(frozen=True, slots=True)
class DrawnWay:
    """One way over the map."""

    name: str
    lines: tuple[NDArray[np.float64], ...]
    """Each (n, 2), m: easting and northing in the survey's CRS."""
    figures: Mapping[str, Any]
    """The properties of its line in route.geojson."""


def read_ways(folder: Path, record: Mapping[str, Any]) -> tuple[DrawnWay, ...]:
    """Read the ways of a folder, or of a file, that `bumpymap route` wrote.

    Parameters
    ----------
    folder : Path
        The folder, or route.geojson itself.
    record : mapping
        The content of run.json of the map: its CRS and units.

    Raises
    ------
    BadInputError
        There is no route.geojson, or it is not one of `bumpymap route`, or its coordinates are not those of the map.
    """
    path = folder / _FILE if folder.is_dir() else folder
    remedy = "Give the folder of a route from one place to another, which `bumpymap route` wrote, as `route`"
    if not path.is_file():
        raise BadInputError(f"there is no file {path}. {remedy}")
    try:
        features = parse_json(read_regular(path).decode())["features"]
        lines = [(feature["properties"], feature["geometry"]) for feature in features if _is_way(feature)]
        if not lines:
            raise BadInputError(f"{path} holds no way. {remedy}")
        place = _Place(record)
        return tuple(
            DrawnWay(str(about.get("name") or "way"), tuple(place.metres(part) for part in _parts(geometry)), about)
            for about, geometry in lines
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, ProjError) as error:
        raise BadInputError(f"cannot read {path} as a route: {error}. {remedy}") from error


def _is_way(feature: Mapping[str, Any]) -> bool:
    return str(feature["geometry"]["type"]).endswith("LineString")


def _parts(geometry: Mapping[str, Any]) -> Iterator[NDArray[np.float64]]:
    parts = geometry["coordinates"] if geometry["type"] == "MultiLineString" else [geometry["coordinates"]]
    for part in parts:
        yield np.array([position[:2] for position in part], dtype=np.float64).reshape(-1, 2)


class _Place:
    """From the coordinates of route.geojson to metres of the map's grid."""

    def __init__(self, record: Mapping[str, Any]) -> None:
        crs = record.get("crs")
        self._unit = float(record["metres_per_unit"]["horizontal"])
        self._forward = None
        if crs is not None:
            known = stated_crs(crs["wkt"])
            plane = known.sub_crs_list[0] if known.is_compound else known
            self._forward = Transformer.from_crs("OGC:CRS84", plane, always_xy=True)

    def metres(self, part: NDArray[np.float64]) -> NDArray[np.float64]:
        if self._forward is not None:
            part = np.column_stack(self._forward.transform(part[:, 0], part[:, 1]))
        if not np.isfinite(part).all():
            raise ValueError("a position has no coordinates in the CRS of the map")
        return np.round(part * self._unit, _DECIMALS)
