"""A graph of ways for the route server of Nav2 (nav2_route), as GeoJSON in the local frame.

There is one node in each square of open tiles of about the same cost. Squares have 1, 3, 9 or 27 tiles on a side, so
that the middle of each is the middle of a tile, and lie in one another without remainder. Open ground of even cost gets
large squares; along everything closed or dearer they shrink to single tiles. The straight line between the middles of
two squares that share a side stays inside the two: it crosses that side within the smaller square. So thinning never
cuts off ground that can be reached.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from bumpymap.core import BadInputError
from bumpymap.views.export.area import FRAME, ExportArea, passable_cost, write_file
from bumpymap.views.export.settings import NodeSquare

__all__ = [
    "SQUARES",
    "Lattice",
    "Squares",
    "line_cost",
    "make_graph",
    "make_lattice",
    "make_squares",
    "write_graph",
]

_CHUNK = 4_000_000
"""Crossings of lines with borders of tiles that are held at once."""


def line_cost(
    factor: NDArray[np.floating], start: NDArray[np.integer], stop: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Integrate a factor along straight lines from tile centre to tile centre.

    A line that touches a corner of tiles needs all four tiles around it to be open, so none slips between two closed
    tiles. Lines between centres never run along a border.

    Parameters
    ----------
    factor : float (rows, cols)
        Cost per unit of length; inf where closed.
    start, stop : int (n, 2)
        Row and column of the tiles.

    Returns
    -------
    float64 (n,)
        In sides of a tile; inf where a line meets a closed tile.
    """
    cost = np.empty(len(start))
    if not len(start):
        return cost
    longest = int(np.abs(stop - start).max())
    step = max(1, _CHUNK // (2 * longest + 2))
    for first in range(0, len(start), step):
        part = slice(first, first + step)
        cost[part] = _integrate(factor, start[part], stop[part])
    return cost


def _integrate(
    factor: NDArray[np.floating], start: NDArray[np.integer], stop: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Cut each line where it crosses a border, as share of its length, and sum up its pieces.

    Equal shares of a row's and a column's border are equal fractions, so they round to the same number: a corner is a
    piece of length 0, exactly.
    """
    move = stop - start
    cuts = np.sort(np.concatenate([_crossings(move[:, 0]), _crossings(move[:, 1])], axis=1), axis=1)
    shares = np.concatenate([np.zeros((len(cuts), 1)), cuts, np.ones((len(cuts), 1))], axis=1)
    piece = np.diff(shares, axis=1)
    middle = shares[:, :-1] + 0.5 * piece
    place = [start[:, axis, None] + 0.5 + move[:, axis, None] * middle for axis in (0, 1)]
    corner = (piece == 0.0) & (middle < 1.0)
    line, number = np.nonzero(corner)
    row, col = (np.rint(axis[line, number]).astype(np.int64) for axis in place)
    around = [factor[row - up, col - left] for up in (0, 1) for left in (0, 1)]
    length = np.hypot(move[:, 0], move[:, 1])[:, None] * piece
    row, col = (
        np.minimum(np.floor(axis).astype(np.int64), size - 1) for axis, size in zip(place, factor.shape, strict=True)
    )
    # One by one, so that the zeros that fill short lines change no bit.
    cost = np.cumsum(np.where(length > 0.0, factor[row, col], 0.0) * length, axis=1)[:, -1]
    cost[line[~np.isfinite(np.stack(around)).all(axis=0)]] = np.inf
    return cost


def _crossings(move: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return the shares of the lines at which they cross borders along one axis, (n, most); 1 fills the rest."""
    count = np.abs(move)[:, None]
    number = np.arange(int(count.max(initial=0)))
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(number < count, (number + 0.5) / count, 1.0))


SQUARES: tuple[NodeSquare, ...] = get_args(NodeSquare)
"""Sides of squares, tiles."""
_ALIKE = 1.5
"""Largest ratio of the costs of tiles in one square: ways still bend around dearer ground."""
_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Tiles to the east, south, south-east, south-west; the others are these, seen from the other side."""


@dataclass(frozen=True, slots=True)
class Squares:
    """Open tiles, divided into squares."""

    row: NDArray[np.int64]
    """(n,) row of each square's middle tile in the window, from the north."""
    col: NDArray[np.int64]
    """(n,) column, from the west."""
    side: NDArray[np.int64]
    """(n,) side, tiles."""
    number: NDArray[np.int64]
    """(rows, cols) number of the square that each tile lies in; -1 where closed."""


@dataclass(frozen=True, slots=True)
class Lattice:
    """A connected graph of squares."""

    row: NDArray[np.int64]
    """(n,) row of each node's tile in the window, from the north."""
    col: NDArray[np.int64]
    """(n,) column, from the west."""
    first: NDArray[np.int64]
    """(m,) number of the node at one end of each edge."""
    second: NDArray[np.int64]
    """(m,) at the other end."""
    cost: NDArray[np.float64]
    """(m,) cost of the straight line between them, in sides of a tile; the same in both directions."""
    tiles_left_out: int
    """Open tiles that are not connected with the largest part, and were left out."""


def make_squares(factor: NDArray[np.floating], largest: int, origin: tuple[int, int]) -> Squares:
    """Divide the open tiles into the largest squares of open tiles of about the same cost.

    Parameters
    ----------
    factor : float (rows, cols)
        Cost per unit of length; inf where closed.
    largest : int
        Largest side, one of ``SQUARES``.
    origin : (int, int)
        Position of the array's first row and column in the grid of squares: crops of one map share their squares.
    """
    before = origin[0] % largest, origin[1] % largest
    after = tuple(-(first + size) % largest for first, size in zip(before, factor.shape, strict=True))
    padded = np.pad(factor, tuple(zip(before, after, strict=True)), constant_values=np.inf)
    side = _sides(padded, largest)
    row, col = np.indices(padded.shape)
    middle = (row // side * side + side // 2) * padded.shape[1] + col // side * side + side // 2
    is_open = np.isfinite(padded)
    node = np.flatnonzero((middle == row * padded.shape[1] + col) & is_open)
    numbers = np.full(padded.size, -1, np.int64)
    numbers[node] = np.arange(len(node))
    rows, cols = factor.shape
    inside = np.where(is_open, numbers[middle], -1)[before[0] : before[0] + rows, before[1] : before[1] + cols]
    return Squares(row.ravel()[node] - before[0], col.ravel()[node] - before[1], side.ravel()[node], inside)


def _sides(factor: NDArray[np.floating], largest: int) -> NDArray[np.int64]:
    """Return the side of the square that each tile lies in; 1 where closed."""
    side = np.ones(factor.shape, np.int64)
    low, high = factor, factor
    for size in SQUARES[1 : SQUARES.index(largest) + 1]:
        rows, cols = low.shape[0] // 3, low.shape[1] // 3
        low = low.reshape(rows, 3, cols, 3).min(axis=(1, 3))
        high = high.reshape(rows, 3, cols, 3).max(axis=(1, 3))
        alike = np.isfinite(high) & (high <= _ALIKE * low)
        side[np.repeat(np.repeat(alike, size, axis=0), size, axis=1)] = size
    return side


def make_lattice(factor: NDArray[np.floating], squares: Squares) -> Lattice:
    """Make the graph: nodes in the middle of squares, edges where a straight line crosses only open tiles.

    Only the connected part with most tiles is kept: from each of its nodes there is a way to every other.

    Parameters
    ----------
    factor : float (rows, cols)
        Cost per unit of length; inf where closed.
    squares : Squares
        From `make_squares`.
    """
    nodes = np.stack([squares.row, squares.col], axis=1)
    count = len(nodes)
    first, second = _pairs(squares.number, count)
    cost = line_cost(factor, nodes[first], nodes[second])
    usable = np.isfinite(cost)
    first, second, cost = first[usable], second[usable], cost[usable]
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    _, part = connected_components(graph, directed=False)
    kept = part == np.bincount(part, weights=squares.side**2, minlength=1).argmax()
    number = np.cumsum(kept) - 1
    inside = kept[first]
    return Lattice(
        nodes[kept, 0],
        nodes[kept, 1],
        number[first[inside]],
        number[second[inside]],
        cost[inside],
        tiles_left_out=int((squares.side[~kept] ** 2).sum()),
    )


def _pairs(number: NDArray[np.int64], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the numbers of squares that touch, each pair once, in order."""
    rows, cols = number.shape
    found = [np.empty(0, np.int64)]
    for down, right in _NEIGHBOURS:
        one = number[: rows - down, max(0, -right) : cols - max(0, right)]
        other = number[down:, max(0, right) : cols - max(0, -right)]
        touch = (one != other) & (one >= 0) & (other >= 0)
        pair = np.sort(np.stack([one[touch], other[touch]]), axis=0)
        found.append(np.unique(pair[0] * count + pair[1]))
    first, second = np.divmod(np.unique(np.concatenate(found)), max(count, 1))
    return first, second


_MAX_TILES = 9_000_000
"""Most tiles that are thinned at once."""
_USUAL_NODES, _MAX_NODES = 5_000, 100_000
_BATCH = 5_000
"""Features that are written at once."""


def make_graph(area: ExportArea, every: int | None) -> tuple[Lattice, int]:
    """Thin the passable tiles of an area to a graph; return it, and the side of its largest squares, tiles.

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
    return lattice, every


def _thin(factor: NDArray[np.float64], every: int | None, origin: tuple[int, int]) -> tuple[int, Squares]:
    for side in SQUARES if every is None else (every,):
        squares = make_squares(factor, side, origin)
        if len(squares.row) <= _USUAL_NODES:
            break
    return side, squares


def write_graph(folder: Path, area: ExportArea, lattice: Lattice, every: int) -> dict[str, Any]:
    """Write graph.geojson, and return what the sidecar file says of it."""
    parts = [b'{"type":"FeatureCollection","name":"bumpymap","features":[\n']
    features, separator = [], b""
    for feature in _features(area, lattice):
        features.append(json.dumps(feature, separators=(",", ":"), allow_nan=False))
        if len(features) == _BATCH:
            parts.append(separator + ",\n".join(features).encode())
            features, separator = [], b",\n"
    if features:
        parts.append(separator + ",\n".join(features).encode())
    write_file(folder / "graph.geojson", *parts, b"\n]}\n")
    nodes, edges = len(lattice.row), 2 * len(lattice.cost)
    return {
        "graph": {
            "nodes": nodes,
            "edges": edges,
            "tiles_left_out": lattice.tiles_left_out,
            "largest_square": every,
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
