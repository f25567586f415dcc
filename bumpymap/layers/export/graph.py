"""A graph of ways for the route server of Nav2 (nav2_route), as GeoJSON in the local frame."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.layers.export.area import FRAME, ExportArea
from bumpymap.layers.export.lattice import SQUARES, Lattice, Squares, make_lattice, make_squares
from bumpymap.layers.export.target import write_file
from bumpymap.layers.export.values import passable_cost

__all__ = ["WayGraph", "make_graph", "write_graph"]

_MAX_TILES = 9_000_000
"""Most tiles that are thinned at once."""
_USUAL_NODES, _MAX_NODES = 5_000, 100_000
_BATCH = 5_000
"""Features that are written at once."""


@dataclass(frozen=True, slots=True)
class WayGraph:
    """The graph of an area."""

    lattice: Lattice
    every: int
    """Side of the largest squares that hold one node each, tiles."""


def make_graph(area: ExportArea, every: int | None) -> WayGraph:
    """Thin the passable tiles of an area to a graph.

    Parameters
    ----------
    area : ExportArea
        With one cell a tile.
    every : int, optional
        Side of the largest squares that hold one node each, one of ``SQUARES``; else the smallest that gives at most
        5,000 nodes, or 27.

    Raises
    ------
    BadInputError
        The area is too large, holds no two passable tiles that are connected, or gives too many nodes.
    """
    window = area.window
    if window.cols * window.rows > _MAX_TILES:
        raise BadInputError(
            f"the area has {window.cols * window.rows:,} tiles; a graph is made of {_MAX_TILES:,} at most. "
            "Crop it with `around` and `radius`"
        )
    factor = np.empty(area.shape)
    for part, lines in area.strips():
        factor[lines] = passable_cost(area.route_map.read(part, ("c_r", "p_fail")))
    factor[~np.isfinite(factor)] = np.inf
    origin = (-(window.row + window.rows), window.col)  # both grow along the array: squares keep their place on Earth
    every, squares = _thin(factor, every, origin)
    if len(squares.row) > _MAX_NODES:
        larger = f"Pass a larger one, up to {SQUARES[-1]}, or crop" if every < SQUARES[-1] else "Crop"
        raise BadInputError(
            f"the graph would have {len(squares.row):,} nodes with `every={every}`; it may have {_MAX_NODES:,}. "
            f"{larger} the area with `around` and `radius`"
        )
    lattice = make_lattice(factor, squares)
    if not len(lattice.cost):
        raise BadInputError(
            f"no two nodes are connected: {len(squares.row)} of the area, with `every={every}`. Choose another area, "
            "or pass a smaller `every`"
        )
    return WayGraph(lattice, every)


def _thin(factor: NDArray[np.float64], every: int | None, origin: tuple[int, int]) -> tuple[int, Squares]:
    for side in SQUARES if every is None else (every,):
        squares = make_squares(factor, side, origin)
        if len(squares.row) <= _USUAL_NODES:
            break
    return side, squares


def write_graph(folder: Path, area: ExportArea, graph: WayGraph) -> dict[str, Any]:
    """Write graph.geojson, and return what the sidecar file says of it."""
    parts = [b'{"type":"FeatureCollection","name":"bumpymap","features":[\n']
    features, separator = [], b""
    for feature in _features(area, graph.lattice):
        features.append(json.dumps(feature, separators=(",", ":"), allow_nan=False))
        if len(features) == _BATCH:
            parts.append(separator + ",\n".join(features).encode())
            features, separator = [], b",\n"
    if features:
        parts.append(separator + ",\n".join(features).encode())
    write_file(folder / "graph.geojson", *parts, b"\n]}\n")
    nodes, edges = len(graph.lattice.row), 2 * len(graph.lattice.cost)
    return {
        "graph": {
            "nodes": nodes,
            "edges": edges,
            "tiles_left_out": graph.lattice.tiles_left_out,
            "largest_square": graph.every,
            "cost": "m of smooth, safe ground",
        }
    }


def _features(area: ExportArea, lattice: Lattice) -> Iterator[dict[str, Any]]:
    """Yield nodes, then edges in both directions; no two features share an id.

    The cost is not overridable: with scorers of its own, such as that of distance, the server would not look at it.
    """
    size, bounds = area.route_map.grid.tile_size, area.bounds
    x = (bounds.west + (lattice.col + 0.5) * size).tolist()
    y = (bounds.north - (lattice.row + 0.5) * size).tolist()
    for number, place in enumerate(zip(x, y, strict=True)):
        geometry = {"type": "Point", "coordinates": place}
        yield {"type": "Feature", "properties": {"id": number, "frame": FRAME}, "geometry": geometry}
    ends = zip(lattice.first.tolist(), lattice.second.tolist(), (lattice.cost * size).tolist(), strict=True)
    number = len(x)
    for first, second, cost in ends:
        for start, end in ((first, second), (second, first)):
            properties = {"id": number, "startid": start, "endid": end, "cost": cost, "overridable": False}
            line = [[[x[start], y[start]], [x[end], y[end]]]]
            geometry = {"type": "MultiLineString", "coordinates": line}
            yield {"type": "Feature", "properties": properties, "geometry": geometry}
            number += 1
