"""Compiled loops over the points of a drive: nearest ranges by direction, voxels, and which were seen through.

Nothing here allocates: the caller sees to it that the table of voxels has room.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.scan._place_kernels import turn_of
from bumpytiles import helper, kernel

Millimetres = Annotated[NDArray[np.int32], 2]
Floats = Annotated[NDArray[np.float64], 2]
Ranges = Annotated[NDArray[np.uint16], 1]
Image = Annotated[NDArray[np.uint16], 2]
Integers = Annotated[NDArray[np.int32], 1]

_MOST = 65_535
"""Farthest distance of a range image, cm: that of 16 bits."""


class VoxelTable(NamedTuple):
    """Voxels by a hash of their key; ``size`` is the number of rows in use."""

    slot: Integers
    """(a power of two,) row of the voxel that has the slot; -1 if free."""
    key: Annotated[NDArray[np.int64], 1]
    """(rows,) which voxel, as the next ones."""
    hits: Integers
    """Frames with a point in it."""
    last: Integers
    """The last of them."""
    mine: Integers
    """Points of that frame so far."""
    held: Integers
    """Points kept of it."""
    turn: Annotated[NDArray[np.uint32], 2]
    """(rows, kept) increasing: points the frame had there before, times 65,536, plus distance from the sensor, cm."""
    place: Annotated[NDArray[np.int32], 3]
    """(rows, kept, 3) where they are, mm."""
    size: Integers
    """(1,)."""


@kernel
def range_image(points: Annotated[NDArray[np.float32], 2], lowest: float, image: Image) -> None:
    """Find the distance of the nearest point in every direction, cm.

    ``points`` (points, 3): in the frame of the sensor, m; ``lowest``: elevation of the lower edge of row 0, as a share
    of a turn. A row is as high as a column is wide; ``image`` (rows, columns): filled; 0 on entry, and where no point
    is.
    """
    rows, columns = image.shape
    for i in range(len(points)):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        flat = math.sqrt(x * x + y * y)
        row = math.floor((turn_of(flat, z) - lowest) * columns)
        column = min(int((turn_of(x, y) + 0.5) * columns), columns - 1)
        if 0 <= row < rows:
            away = min(int(100.0 * math.sqrt(flat * flat + z * z)) + 1, _MOST)
            if image[row, column] == 0 or away < image[row, column]:
                image[row, column] = np.uint16(away)


@helper
def _slot_of(table: VoxelTable, key: int) -> int:
    """Find the slot that holds a key, or the free one where it goes."""
    mask = len(table.slot) - 1
    spread = (key ^ (key >> 29)) * 0x1CE4E5B9BF58476D
    at = (spread ^ (spread >> 32)) & mask
    while table.slot[at] >= 0 and table.key[table.slot[at]] != key:
        at = (at + 1) & mask
    return at


@helper
def _row_of(table: VoxelTable, key: int) -> int:
    """Find the row of a voxel; a new one gets the next."""
    at = _slot_of(table, key)
    row: int = table.slot[at]
    if row < 0:
        row = table.size[0]
        table.slot[at] = np.int32(row)
        table.key[row], table.hits[row], table.last[row] = key, 0, -1
        table.held[row] = 0
        table.size[0] = np.int32(row + 1)
    return row


@kernel
def gather_points(
    place: Millimetres,
    range_cm: Ranges,
    kind: Annotated[NDArray[np.uint8], 1],
    frame: int,
    voxel_mm: int,
    table: VoxelTable,
) -> None:
    """Add points of one frame to their voxels.

    A voxel keeps one point of each frame before it keeps a second of any, so that their spread holds the errors of the
    poses; and those nearest to the sensor, the first frame's of equals.

    ``place`` (points, 3): mm; x and y count from the corner of the block; ``range_cm`` (points,): distance from the
    sensor, cm; ``kind`` (points,): 1 for ground, 0 for others: they have voxels of their own; ``frame``: number of the
    frame; ``voxel_mm``: edge of a voxel; ``table``: has a free row and two free slots for every point.
    """
    most = table.turn.shape[1]
    for i in range(len(place)):
        column, row, level = place[i, 0] // voxel_mm, place[i, 1] // voxel_mm, place[i, 2] // voxel_mm
        key = ((np.int64(level) * 4096 + row) * 4096 + column) * 2 + kind[i]
        at = _row_of(table, key)
        if table.last[at] != frame:
            table.last[at] = np.int32(frame)
            table.hits[at] += 1
            table.mine[at] = 0
        if table.mine[at] == most:
            continue
        turn = np.uint32(table.mine[at] * 65_536 + range_cm[i])
        table.mine[at] += 1
        held = table.held[at]
        if held == most and turn >= table.turn[at, most - 1]:
            continue
        to = held if held < most else most - 1
        while to > 0 and turn < table.turn[at, to - 1]:
            table.turn[at, to] = table.turn[at, to - 1]
            for axis in range(3):
                table.place[at, to, axis] = table.place[at, to - 1, axis]
            to -= 1
        table.turn[at, to] = turn
        for axis in range(3):
            table.place[at, to, axis] = place[i, axis]
        if held < most:
            table.held[at] = np.int32(held + 1)


@kernel
def move_voxels(table: VoxelTable, larger: VoxelTable) -> None:
    """Enter the rows of a table, copied to a larger one, into the slots of that; its slots come free."""
    for row in range(table.size[0]):
        larger.slot[_slot_of(larger, larger.key[row])] = np.int32(row)
    larger.size[0] = table.size[0]


@kernel
def judge_places(
    place: Millimetres,
    origin: Floats,
    lowest: float,
    image: Image,
    limits: Floats,
    found: Annotated[NDArray[np.int32], 2],
) -> None:
    """Count a frame for the places that it saw through, and for those that something hid from it.

    A place is seen through if all beams near its direction ended well behind it, hidden if all ended well before it.

    Parameters
    ----------
    place : (places, 3) int32
        mm; x and y count from the corner of the block.
    origin : (3, 4) float64
        Transform from the block (m) to the frame of the sensor.
    lowest, image
        As of `range_image`.
    limits : (1, 3) float64
        Places farther from the sensor are not judged, m. A beam ends well behind a place if it is so much longer: m,
        and share of the distance.
    found : (4, places) int32
        Counted up: frames that saw through it, from which it was hidden, that had no return near its direction, and
        that had returns near it.
    """
    rows, columns = image.shape
    for v in range(len(place)):
        px, py, pz = place[v, 0] * 0.001, place[v, 1] * 0.001, place[v, 2] * 0.001
        x = origin[0, 0] * px + origin[0, 1] * py + origin[0, 2] * pz + origin[0, 3]
        y = origin[1, 0] * px + origin[1, 1] * py + origin[1, 2] * pz + origin[1, 3]
        z = origin[2, 0] * px + origin[2, 1] * py + origin[2, 2] * pz + origin[2, 3]
        flat = math.sqrt(x * x + y * y)
        away = math.sqrt(flat * flat + z * z)
        row = math.floor((turn_of(flat, z) - lowest) * columns)
        if away > limits[0, 0] or not 0 < row < rows - 1:
            continue
        column = min(int((turn_of(x, y) + 0.5) * columns), columns - 1)
        nearest, farthest = _MOST, 0
        for up in range(-1, 2):
            for left in range(-1, 2):
                seen = int(image[row + up, (column + left) % columns])
                if seen > 0:
                    nearest, farthest = min(nearest, seen), max(farthest, seen)
        slack = away * limits[0, 2] + limits[0, 1]
        if farthest == 0:
            found[2, v] += 1
        elif image[row, column] > 0 and nearest * 0.01 > away + slack:
            found[0, v] += 1
        elif farthest * 0.01 < away - slack:
            found[1, v] += 1
        else:
            found[3, v] += 1


@kernel
def draw_things(
    things: Annotated[NDArray[np.float32], 2], cell_m: float, drawn: Annotated[NDArray[np.uint8], 2]
) -> None:
    """Draw what stands around a sensor, seen from above: 4 in the cell of a thing, 2 beside it, 1 at its corners.

    ``things`` (n, 3): along the axes of the world, m; ``drawn`` (rows, columns): filled, the sensor in its middle; 0 on
    entry.
    """
    rows, columns = drawn.shape
    for i in range(len(things)):
        column = math.floor(things[i, 0] / cell_m) + columns // 2
        row = math.floor(things[i, 1] / cell_m) + rows // 2
        if 0 < row < rows - 1 and 0 < column < columns - 1:
            for up in range(-1, 2):
                for right in range(-1, 2):
                    ink = 4 >> (abs(up) + abs(right))
                    if drawn[row + up, column + right] < ink:
                        drawn[row + up, column + right] = np.uint8(ink)


@kernel
def match_things(
    things: Annotated[NDArray[np.float32], 2],
    middle: Annotated[NDArray[np.float64], 1],
    turns: Floats,
    cell_m: float,
    drawn: Annotated[NDArray[np.uint8], 2],
    found: Annotated[NDArray[np.int32], 3],
) -> None:
    """Add up what is drawn at the places of things, for turns about their sensor and moves by whole cells.

    ``things`` (n, 3): around their sensor, m; ``middle`` (2,): where that is from the sensor of `draw_things`, m;
    ``turns`` (turns, 2): cosine and sine of each; ``found`` (turns, rows, columns): filled, no move in the middle; 0 on
    entry.
    """
    turned, high, wide = found.shape
    rows, columns = drawn.shape
    for turn in range(turned):
        cosine, sine = turns[turn, 0], turns[turn, 1]
        for i in range(len(things)):
            x, y = np.float64(things[i, 0]), np.float64(things[i, 1])
            column = math.floor((middle[0] + cosine * x - sine * y) / cell_m) + columns // 2 - wide // 2
            row = math.floor((middle[1] + sine * x + cosine * y) / cell_m) + rows // 2 - high // 2
            if 0 <= row <= rows - high and 0 <= column <= columns - wide:
                for up in range(high):
                    for right in range(wide):
                        found[turn, up, right] += drawn[row + up, column + right]
