"""The cheapest way between two points of a window, which tiles can be reached, and how a way is pulled tight.

Field coordinates (r, c) of a window are in tiles: r from its north edge southwards, c from its west edge eastwards;
the middle of ``cost[i, j]`` is at (i + 0.5, j + 0.5). A tile is closed where its cost is infinite; everything outside
the window is closed.

A line keeps a margin: its distance to every closed tile, a full square, is at least that. Start and goal may be nearer
to closed tiles; then the straight part that leads away from such an end, and it alone, need not keep more from these
tiles than the end does. A margin of 0 counts as 1e-6 tiles, so that no line slips between two closed tiles that touch
at a corner.

*Pulling tight* goes on in turns until nothing is gained: corners are left out wherever the
straight line costs no more (the cheapest choice among several in a row); new corners are set beside each that is left
and in the middle of long straight parts; all corners are moved by ever smaller steps. Every cost is the exact integral.
The result is never dearer, and never nearer to closed tiles than allowed.

*The search* goes from middle to middle of tiles by 48 moves, each the exact integral of the cost over
the tiles that it crosses, clear of closed ones. Start and goal lie anywhere in their tiles and see the middles around
them straight; if they see each other, the straight line competes. `pull_tight` then pulls the way tight.

Between neighbouring directions of the 48 lie at most 14 degrees, so that a way over even ground made of them is at most
0.75 % too long (the 8 moves of many least-cost tools: 8.2 %); `pull_tight` takes that off.

A search prefers one of several ways that cost the same, or nearly so, by the order in which it looks at tiles, and a
local search ends where it began. So every search runs in the same frame: from the end in the cheaper tile to the other,
southwards more than eastwards, and never northwards or westwards. (Ends in one row, one column or on one diagonal leave
two such frames, mirror images of each other: there, ways by moves still cost the same on a mirrored map, and pulled
ways nearly so.)

Each move costs what the ground does, and what slopes add in its direction. There and back cost the same to the last
bit, unless climbing costs other than descending, and so do ways on turned maps, as a rule; see `SearchFrame`. Moves
decide on which side of closed tiles a way passes; where both sides cost nearly the same, the way may be the dearer by a
percent or two.
"""

import math
from collections.abc import Callable
from functools import cache
from math import gcd
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Floats, TracedLine, loops


class Costs(NamedTuple):
    """Costs of the ground of a window."""

    tiles: NDArray[np.float32]
    """(rows, cols) cost per tile of length, at least 1; infinite where closed."""
    gradient: NDArray[np.float32]
    """(rows, cols, 2) rise per length southwards and eastwards; (0, 0, 2) if slopes cost nothing."""
    climb: float
    """Cost of a rise of 1 along the way, tiles."""
    descent: float
    """The same downwards."""
    side: float
    """Cost of a length of 1 across a gradient of 1."""
    steepest: float
    """Directions across a larger gradient are barred."""


LEAST_MARGIN = 1e-6
"""Margins below this one, tiles, count as this one: what touches a closed tile may slip between two of them."""
_MAX_MARGIN = 0.5
"""Margin that closes a corridor of one tile, tiles."""
_WIDER = 1.05
"""Margin of a search as a multiple of that of the line (chosen)."""


def as_costs(cost: NDArray[np.floating] | Costs) -> Costs:
    """Return costs as loops take them, with what slopes add, nothing unless they have it.

    Raises ValueError unless they are (rows, cols).
    """
    tiles = np.ascontiguousarray(cost.tiles if isinstance(cost, Costs) else cost, np.float32)
    if tiles.ndim != 2:
        raise ValueError(f"cost has the shape {tiles.shape}; it must be rows and columns")
    if isinstance(cost, Costs):
        return cost._replace(tiles=tiles, gradient=np.ascontiguousarray(cost.gradient, np.float32))
    return Costs(tiles, np.empty((0, 0, 2), np.float32), 0.0, 0.0, 0.0, math.inf)


def as_margin(margin: float) -> float:
    """Return the margin that lines keep; raises ValueError unless it is within [0, 0.5) tiles."""
    if not 0.0 <= margin < _MAX_MARGIN:
        raise ValueError(f"margin is {margin} tiles; it must be at least 0 and below {_MAX_MARGIN}")
    return max(margin, LEAST_MARGIN)


def wide_margin(margin: float) -> float:
    """Return the margin that a search keeps: a twentieth more, so that the way round a corner needs few corners."""
    least = as_margin(margin)
    return min(_WIDER * least, 0.5 * (least + _MAX_MARGIN))


def _as_line(line: NDArray[np.floating]) -> Floats:
    """Return a line as loops take it."""
    if line.ndim != 2 or line.shape[1] != 2 or not np.isfinite(line).all():
        raise ValueError(f"a line is (n, 2) finite field coordinates, not {line.shape}")
    return np.ascontiguousarray(line, np.float64)


def trace(cost: NDArray[np.floating] | Costs, line: NDArray[np.floating]) -> TracedLine:
    """Cut a line at the borders of tiles.

    ``cost``: as `pull_tight`. It decides where a line runs along a border: there
    the dearer tile counts; ``line`` (n, 2): field coordinates of the corners, within the window. Raises ValueError: the
    line leaves the window.
    """
    costs, points = as_costs(cost), _as_line(line)
    rows, cols = costs.tiles.shape
    if line.size and ((line < 0.0) | (line > np.array([rows, cols]))).any():
        raise ValueError(f"the line leaves the window of {rows} x {cols} tiles")
    room = int(np.abs(np.diff(np.floor(points), axis=0)).sum()) + 3 * len(line)
    integers = np.empty((3, room), np.int64)
    out = TracedLine(integers[0], integers[1], np.empty(room), integers[2])
    count = loops.trace_line(costs, points, out)
    return TracedLine(out.row[:count], out.col[:count], out.length[:count], out.part[:count])


def line_cost(cost: NDArray[np.floating] | Costs, line: NDArray[np.floating]) -> float:
    """Return the exact integral of the cost along a line, in tiles; infinite if it crosses a closed tile.

    ``cost``: as `pull_tight`; ``line`` (n, 2): field coordinates of the corners.
    """
    return loops.sum_cost(as_costs(cost), _as_line(line))


def is_clear(cost: NDArray[np.floating] | Costs, line: NDArray[np.floating], margin: float = 0.0) -> bool:
    """Say whether a line keeps a margin from all closed tiles; see the module for start and goal.

    ``cost`` (rows, cols): infinite where closed; ``line`` (n, 2): field coordinates of the corners; ``margin``: tiles,
    at least 0 and below 0.5.
    """
    return loops.check_clear(as_costs(cost), _as_line(line), as_margin(margin))


_ON_BORDER, _OFF_BORDER = 1e-7, 1e-6
"""Distance from a border of corners that are moved off it, and distance that they have then, tiles (chosen)."""
_SKIPPED = 12
"""Corners in a row that one look may leave out (chosen); the next look begins with those that are left."""
_ROUNDS, _SWEEPS, _GAIN = 6, 60, 1e-6
"""Most rounds of pulling, most sweeps over all corners in each, and least gain of a round that is followed by another,
as a share of the cost (chosen)."""
_LEAST_MOVE, _WORTH = 1e-10, 1e-7
"""Least gain for which a corner is moved, and least saving for which it stays, as shares of the cost (chosen)."""
LEAST_SAVING = 1e-3
"""Least saving of a corner of a thinned line by default, tiles: 3 mm (chosen)."""
_FIRST_STEP, _LEAST_STEP = 0.5, 2e-5
"""First and least step by which corners are moved, tiles: down to 0.06 mm (chosen)."""
_AXES = np.arange(4) * 0.5 * np.pi
_TURNED = np.array([0.25, 0.125, 0.375, 0.0625, 0.1875, 0.3125, 0.4375])[:, None] * np.pi + _AXES
_ANGLES = np.concatenate([np.broadcast_to(_AXES, _TURNED.shape), _TURNED], axis=1).ravel()
_DIRECTIONS = np.column_stack([np.sin(_ANGLES), np.cos(_ANGLES)])
"""Along the axes always, and four more at angles that change: curved margins leave narrow ways to go."""
_SPARE = 5e-10
"""Addition to the margin, tiles: the line stays clear when its coordinates are rounded in other windows."""
_LEAST_PART = 1e-3
"""Shortest straight part on which new corners are set, tiles (chosen)."""


def pull_tight(cost: NDArray[np.floating] | Costs, line: Floats, margin: float = 0.0) -> Floats:
    """Return a line between the same ends that keeps the margin and costs no more.

    ``cost`` as of `find_way`; ``line`` (n, 2): field coordinates of a line that keeps the margin; ``margin``: tiles, at
    least 0 and below 0.5. Raises ValueError: the line has fewer than two corners, or crosses a closed tile.
    """
    cost = as_costs(cost)
    given = line_cost(cost, line)
    if len(line) < 2 or not given < math.inf:
        raise ValueError(f"a line of {len(line)} corners that costs {given} cannot be pulled tight")
    kept = as_margin(margin) + _SPARE
    least, worth = _LEAST_MOVE * given, _WORTH * given
    best = _leave_out(cost, kept, worth, line)
    total = line_cost(cost, best)
    for _ in range(_ROUNDS):
        points = _with_new_corners(best)
        loops.move_corners(cost, kept, least, points, _DIRECTIONS, _FIRST_STEP, _LEAST_STEP, _SWEEPS)
        tried = _leave_out(cost, kept, worth, points)
        reached = line_cost(cost, tried)
        gain = total - reached
        if gain > 0.0:
            best, total = tried, reached
        if gain <= _GAIN * given:
            break
    return best if total <= given else line


def thin_out(cost: Costs, line: Floats, margin: float, least_saving: float) -> Floats:
    """Leave out corners of a tight line that hardly save anything; move those on borders of tiles to the cheaper side.

    Of an arc round a corner a few are left. A line along a border costs what the dearer side does: there, the last bit
    of a coordinate would decide.

    ``cost``, ``line``: as `pull_tight`; the line keeps more than the margin, or the arcs stay as they are; ``margin``:
    tiles, at least 0 and below 0.5; ``least_saving``: what a corner saves at least, tiles.
    """
    thin = _leave_out(cost, as_margin(margin) + _SPARE, least_saving, line)
    moved = thin.copy()
    loops.leave_borders(cost, moved, _ON_BORDER, _OFF_BORDER)
    return moved if is_clear(cost, moved, margin) and line_cost(cost, moved) < math.inf else thin


def _leave_out(cost: Costs, margin: float, worth: float, line: Floats) -> Floats:
    """Leave out corners without which the line costs no more than ``worth`` until none can be."""
    points = np.array(line, np.float64, order="C")
    return points[: loops.leave_out(cost, margin, worth, points, _SKIPPED)]


def _with_new_corners(line: Floats) -> Floats:
    """Set corners on every straight part: in its middle, and near its ends where it is long."""
    part = np.diff(line, axis=0)
    length = np.sqrt((part**2).sum(axis=1))
    near = np.minimum(1.0 / np.maximum(length, 1.0), 0.25)
    share = np.column_stack([np.zeros_like(near), near, np.full_like(near, 0.5), 1.0 - near])
    points = line[:-1, None] + share[..., None] * part[:, None]
    wanted = (share == 0.0) | (length > _LEAST_PART)[:, None]
    return np.ascontiguousarray(np.concatenate([points[wanted], line[-1:]]))


Integers = NDArray[np.int64]

NOT_REACHED = 255
"""In place of a move: no way leads there; 254: straight from the start."""
REACH = 4
"""Tiles that a move goes at most, along each axis."""
MOVES: NDArray[np.int64] = np.array(
    [(row, col) for row in range(-REACH, REACH + 1) for col in range(-REACH, REACH + 1) if gcd(row, col) == 1]
)
"""(48, 2) tiles southwards and eastwards of each move; the number of a move is its row here."""


class MoveTables(NamedTuple):
    """The k moves from tile to tile of a flattened window; see `bumpymap.route.search`."""

    step: Integers
    """(k,) from tile to tile."""
    length: Floats
    """(k,) in tiles."""
    end: Floats
    """(k,) length in the tile where it starts, and in the one where it ends, tiles."""
    first_piece: Integers
    """(k + 1,) where a move's other pieces start in the next two."""
    piece: Integers
    """From the tile where the move starts to one that it crosses."""
    piece_length: Floats
    """Length in that tile, tiles."""
    direction: Floats
    """(k, 2) southwards and eastwards in a length of 1."""
    near_north: Integers
    """(k,) tiles that must be open, those that it crosses included, as bits of the north half around the start."""
    near_south: Integers
    """(k,) the same of the south half."""


class Ground(NamedTuple):
    """A flattened window with its ring."""

    cost: Costs
    closed: NDArray[np.uint8]
    """A bit for each tile, from the least of a byte on: whether it is closed; one byte more than these take."""
    start: int
    """Its tile."""
    goal_row: float
    goal_col: float
    """Field coordinates of the goal."""
    least: float
    """No tile costs less; at least 1."""
    bound: float
    """No tile on any way to the goal costs less, those outside the window included; 0 to search all around alike."""


@cache
def _traced_moves(margin: float) -> tuple[MoveTables, NDArray[np.int64]]:
    """Trace every move; also return the tiles between their ends, (n, 2) from where each starts.

    ``margin``: distance that a way keeps from closed tiles, tiles. Steps of a flattened window are filled in later.
    """
    middle = REACH + 0.5
    open_ground = np.ones((2 * REACH + 1, 2 * REACH + 1), np.float32)
    # First and last piece are as long as each other, and in tables of their own.
    traced = [trace(open_ground, np.array([[middle, middle], middle + move])) for move in MOVES]
    near = np.empty((len(MOVES), *open_ground.shape), np.bool_)
    loops.find_near(np.vstack([np.zeros((1, 2)), MOVES]) + middle, margin, near)
    bits = 1 << np.arange(REACH * len(open_ground) + len(open_ground))
    tables = MoveTables(
        step=np.empty(0, np.int64),
        length=np.sqrt((MOVES.astype(np.float64) ** 2).sum(axis=1)),
        end=np.array([each.length[0] for each in traced]),
        first_piece=np.cumsum([0, *(len(each.length) - 2 for each in traced)]),
        piece=np.empty(0, np.int64),
        piece_length=np.concatenate([each.length[1:-1] for each in traced]),
        direction=MOVES / np.sqrt((MOVES.astype(np.float64) ** 2).sum(axis=1))[:, None],
        near_north=near[:, REACH::-1].reshape(len(near), -1) @ bits,
        near_south=near[:, :REACH:-1].reshape(len(near), -1) @ bits[: -len(open_ground)],
    )
    return tables, np.concatenate([np.column_stack([each.row, each.col])[1:-1] for each in traced]) - REACH


Point = tuple[float, float]
"""Field coordinates (r, c)."""
Number = TypeVar("Number", bound=np.generic)

_QUANTUM = 2.0**-30
"""Step of coordinates inside a tile, tiles: 3 nm of 3 m, and exact in float64 for 2 ** 22 tiles."""


def settle_point(point: Point) -> Point:
    """Round a point to within 1e-9 tiles, to a place inside its tile.

    Turned and shifted coordinates are exact then, and no point is on a border, where it would change its tile.
    """
    if not (math.isfinite(point[0]) and math.isfinite(point[1])):
        raise ValueError(f"{point} is no point: field coordinates are two finite numbers")
    tiles, most = [math.floor(x) for x in point], round(1.0 / _QUANTUM) - 1
    r, c = (min(max(round((x - tile) / _QUANTUM), 1), most) for x, tile in zip(point, tiles, strict=True))
    return tiles[0] + r * _QUANTUM, tiles[1] + c * _QUANTUM


class SearchFrame(NamedTuple):
    """Turns and flips of a window, in this order, and of the ends of a way."""

    back: bool
    """True if the search runs from goal to start."""
    flips: tuple[bool, bool]
    """True if rows, columns run the other way."""
    transpose: bool
    shape: tuple[int, int]
    """Of the window."""

    @classmethod
    def of(cls, tiles: NDArray[np.float32], start: Point, goal: Point) -> "SearchFrame":
        """Choose the frame for a start and a goal in the window."""
        back = _rank(tiles, start) > _rank(tiles, goal)
        down, right = (goal[0] - start[0], goal[1] - start[1]) if not back else (start[0] - goal[0], start[1] - goal[1])
        return cls(back, (down < 0.0, right < 0.0), abs(down) < abs(right), (tiles.shape[0], tiles.shape[1]))

    def turn(self, values: NDArray[Number]) -> NDArray[Number]:
        """Turn an array (rows, cols); a view."""
        turned = values[:: -1 if self.flips[0] else 1, :: -1 if self.flips[1] else 1]
        return turned.swapaxes(0, 1) if self.transpose else turned

    def turn_costs(self, cost: Costs) -> Costs:
        """Turn costs: what was uphill from the goal is downhill then."""
        signs = np.where(self.flips, np.float32(-1.0), np.float32(1.0))
        gradient = (self.turn(cost.gradient) * signs)[..., :: -1 if self.transpose else 1]
        cost = cost._replace(climb=cost.descent, descent=cost.climb) if self.back else cost
        return cost._replace(tiles=self.turn(cost.tiles), gradient=gradient)

    def turn_back(self, values: NDArray[Number]) -> NDArray[Number]:
        """Undo `turn`; a view."""
        turned = values.T if self.transpose else values
        return turned[:: -1 if self.flips[0] else 1, :: -1 if self.flips[1] else 1]

    def turn_line(self, line: Floats) -> Floats:
        """Turn a line (n, 2), and put its ends in order."""
        line = np.where(self.flips, self.shape - line, line)
        return line[:: -1 if self.back else 1, :: -1 if self.transpose else 1]

    def turn_line_back(self, line: Floats) -> Floats:
        """Undo `turn_line`."""
        line = line[:: -1 if self.back else 1, :: -1 if self.transpose else 1]
        return np.where(self.flips, self.shape - line, line)


def _rank(cost: NDArray[np.float32], point: Point) -> tuple[float, ...]:
    """Return what tells two ends apart: the same on turned maps, but for the last two numbers."""
    row, col = math.floor(point[0]), math.floor(point[1])
    r, c = abs(point[0] - row - 0.5), abs(point[1] - col - 0.5)
    return float(cost[row, col]), max(r, c), min(r, c), *point


BYTES_PER_TILE, BYTES_PER_TILE_BY_SLOPE = 36, 24
"""Memory that a search takes at most: the costs that it is given, with and without the ring, and the arrays below; and
what is added where slopes cost. The queue of tiles, in which one may stand several times, took up to 8 of the 36
(random ground of 1,200 x 1,200 tiles)."""
MOST_TILES = 2_000_000_000
"""Tiles of a window, which the search numbers with 32 bits; the ring takes the rest."""


_NEARLY = 1.0 - 1e-9
"""Of the steepest gradient that is driven across, in a search: the line may be rounded when it is pulled tight."""


_Reached = tuple[Floats, NDArray[np.uint8], NDArray[np.bool_]]
"""(n,) cost from the start of each tile of a flattened window with its ring, infinite if it is not reached; the move
that led there, or `NOT_REACHED`; whether its cost is final."""


def _search(
    cost: Costs, start: Point, goal: Point | None, margin: float, bound: float
) -> tuple[_Reached, tuple[int, float], Callable[[NDArray[Number]], NDArray[Number]]]:
    """Search a window from a start in an open tile, to a goal or all around.

    ``bound`` as in `seek`. Also return the tile from which the way goes straight to the goal, -1 if the straight line
    is the best, and its cost; and what takes one of the flat arrays to (rows, cols). Raises ValueError where a cost is
    below 1 or NaN.
    """
    tiles, has_slope = cost.tiles, cost.gradient.size > 0
    least = float(tiles.min(initial=math.inf))
    if not least >= 1.0:
        raise ValueError(f"the least cost is {least}; every cost must be a number of at least 1, or infinite")
    rows, width = tiles.shape[0] + 2 * REACH, tiles.shape[1] + 2 * REACH
    margin, count = wide_margin(margin), rows * width
    ringed = cost._replace(
        tiles=np.full((rows, width), np.inf, np.float32),
        gradient=np.zeros((rows, width, 2) if has_slope else (0, 0, 2), np.float32),
        steepest=_NEARLY * cost.steepest,
    )
    inner = np.s_[REACH:-REACH, REACH:-REACH]
    ringed.tiles[inner] = tiles
    if has_slope:
        ringed.gradient[inner] = cost.gradient

    def connected(point: Point, *, from_it: bool) -> Floats:
        """Costs straight from a point to the middles of tiles around it, or from these to it."""
        out = np.full((2 * REACH + 1, 2 * REACH + 1), math.inf)
        ground = ringed if from_it else ringed._replace(climb=ringed.descent, descent=ringed.climb)
        loops.connect(ground, point[0] + REACH, point[1] + REACH, margin, out)
        return out

    enter = connected(start, from_it=True)
    leave, known = np.full_like(enter, math.inf), math.inf
    if goal is not None:
        straight = np.array([start, goal], np.float64) + REACH
        is_straight = is_clear(ringed, straight, margin)
        known = line_cost(ringed, straight) if is_straight else math.inf
        leave = connected(goal, from_it=False)
    closed = np.append(np.packbits(~(ringed.tiles < math.inf), bitorder="little"), np.uint8(0))
    end = (0.0, 0.0) if goal is None else (goal[0] + REACH, goal[1] + REACH)
    first = (math.floor(start[0]) + REACH) * width + math.floor(start[1]) + REACH
    ground = Ground(ringed, closed, first, *end, least, min(least if least < math.inf else 1.0, bound))
    reached = np.full(count, math.inf), np.full(count, NOT_REACHED, np.uint8), np.zeros(count, np.bool_)
    tables, crossed = _traced_moves(margin)
    flat = np.array([width, 1])
    moves = tables._replace(step=MOVES @ flat, piece=crossed @ flat)
    found = loops.search_ways(ground, moves, enter, leave, known, *reached)
    return reached, found, lambda values: values.reshape(rows, width)[inner]


_AROUND = 8
"""Margin around a line by moves within which it is pulled tight, tiles (chosen)."""


class Found(NamedTuple):
    """Result of a search."""

    line: Floats | None
    """(n, 2) the cheapest way by moves, in the frame; None if there is none."""
    settled: NDArray[np.bool_]
    """(rows, cols) tiles from which the goal might be reached for less by a way that leaves the window."""
    frame: SearchFrame
    ground: Costs
    """Costs of the window, in the frame."""


def find_way(
    cost: NDArray[np.floating] | Costs,
    start: Point,
    goal: Point,
    *,
    margin: float = 0.0,
    least_saving: float = LEAST_SAVING,
) -> Floats | None:
    """Find the cheapest way; None if there is none, or start or goal lie in a closed tile or outside the window.

    ``cost`` (rows, cols): per length, at least 1; infinite where closed; or with what slopes add; ``start``, ``goal``:
    field coordinates; ``margin``: distance to closed tiles that the way keeps, at least 0 and below 0.5 tiles;
    ``least_saving``: corners that save less are left out, tiles. Returns (n, 2): field coordinates of its corners, from
    within 1e-9 tiles of the start to the same of the goal. Raises ValueError: a cost below 1 or NaN, a margin or
    coordinates out of range.
    """
    found = seek(cost, start, goal, margin)
    return None if found.line is None else tight_way(found, margin, least_saving)


def tight_way(found: Found, margin: float, least_saving: float = LEAST_SAVING) -> Floats:
    """Pull a way that has been found tight; return its corners, (n, 2) field coordinates."""
    if found.line is None:
        raise ValueError("no way has been found")
    near, corner = _cut_out(found.ground, found.line)
    line = thin_out(near, pull_tight(near, found.line - corner, wide_margin(margin)), margin, least_saving)
    return found.frame.turn_line_back(line + corner)


def _cut_out(cost: Costs, line: Floats) -> tuple[Costs, NDArray[np.int64]]:
    """Return the costs around a line, and the row and column of the first.

    What comes of them depends on the line's place on the map then, and not on the window that it was found in: rounding
    errors are those of the same numbers.
    """
    low = np.floor(line.min(axis=0)).astype(np.int64) - _AROUND
    high = np.floor(line.max(axis=0)).astype(np.int64) + _AROUND + 1
    first, last = np.maximum(low, 0), np.minimum(high, cost.tiles.shape)
    rows, cols = (slice(a, b) for a, b in zip(first - low, last - low, strict=True))

    def cut(values: NDArray[np.float32], beyond: float) -> NDArray[np.float32]:
        near = np.full((*(high - low).tolist(), *values.shape[2:]), beyond, np.float32)
        near[rows, cols] = values[first[0] : last[0], first[1] : last[1]]
        return near

    gradient = cut(cost.gradient, 0.0) if cost.gradient.size else cost.gradient
    return cost._replace(tiles=cut(cost.tiles, math.inf), gradient=gradient), low


def seek(
    cost: NDArray[np.floating] | Costs, start: Point, goal: Point, margin: float, bound: float = math.inf
) -> Found:  # fmt: skip
    """Find the cheapest way by moves.

    ``cost`` as in `find_way`; ``bound`` is what no tile costs less than, those outside the window included, if ways may
    leave it.
    """
    cost = as_costs(cost)
    start, goal = settle_point(start), settle_point(goal)
    tiles, (rows, cols) = cost.tiles, cost.tiles.shape
    at = np.floor([start, goal])
    if (at < 0).any() or (at >= (rows, cols)).any() or np.isinf(tiles[tuple(at.astype(np.int64).T)]).any():
        level = SearchFrame(False, (False, False), False, (rows, cols))
        return Found(None, np.zeros((rows, cols), np.bool_), level, cost)
    frame = SearchFrame.of(tiles, start, goal)
    ground = frame.turn_costs(cost)
    line = frame.turn_line(np.array([start, goal]))
    first, last = ((float(r), float(c)) for r, c in line)
    (_, back, settled), (exit_tile, best), inner = _search(ground, first, last, margin, bound)
    settled = frame.turn_back(inner(settled))
    if not best < math.inf:
        return Found(None, settled, frame, ground)
    if exit_tile >= 0:
        row, col = divmod(exit_tile, ground.tiles.shape[1] + 2 * REACH)
        path = follow_back(inner(back), row - REACH, col - REACH)
        line = np.concatenate([line[:1], path[::-1], line[1:]])
    return Found(line, settled, frame, ground)


def spread(cost: NDArray[np.floating] | Costs, start: Point, margin: float) -> Floats:
    """Return what every tile costs to reach: the cheapest way by moves to its middle, (rows, cols) tiles.

    ``cost``, ``start``, ``margin`` and errors as of `find_way`. Infinite where no way leads (none leads anywhere from a
    closed tile).
    """
    (g, _, _), _, inner = _search(as_costs(cost), settle_point(start), None, margin, 0.0)
    return inner(g)


def follow_back(back: NDArray[np.uint8], row: int, col: int) -> Floats:
    """Follow the moves of a search from a tile that has been reached back to the start.

    Returns field coordinates of the middles of its tiles, (n, 2), the given one first; the start itself is not among
    them. Moves that follow each other in one direction are one.
    """
    path, last = [(row, col)], NOT_REACHED
    while (move := int(back[row, col])) < len(MOVES):
        row, col = row - int(MOVES[move, 0]), col - int(MOVES[move, 1])
        path[-1:] = [(row, col)] if move == last else [path[-1], (row, col)]
        last = move
    return np.array(path, np.float64) + 0.5
