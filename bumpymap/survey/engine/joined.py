"""The tiles of a survey of which a part is not classified: each measured from its ground points, or from all."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import GROUND_SOURCE, NO_CLASS
from bumpymap.rating import is_rateable
from bumpymap.readers import REACH, Lowest, UnclassifiedPart
from bumpymap.survey.engine.block_work import JOINED_POINTS, BlockWork, TileSink
from bumpymap.survey.engine.budget import Workspace
from bumpytiles import TileTable

__all__ = ["lowest_points", "save_joined"]

Marks = NDArray[np.bool_]


def lowest_points(part: UnclassifiedPart, ground: TileTable, every: TileTable) -> Iterator[Lowest]:
    """Yield what `UnclassifiedPart.never_classified` needs, from tiles measured by their ground and by all points."""
    for table, of_ground in ((ground, True), (every, False)):
        for key in filter(table.count, part.blocks(REACH if of_ground else 0)):
            tiles = table.read_blocks([key], ("row", "col", "z_min"))
            yield tiles["row"], tiles["col"], tiles["z_min"], of_ground


def save_joined(
    part: UnclassifiedPart, found: Marks, ground: TileTable, every: TileTable, work: BlockWork, space: Workspace
) -> int:
    """Save the blocks in which tiles are measured from all points, and which tiles these are; return their number.

    They are the ``found`` ones, (rows, cols) of the window of ``part``, and those of the others that lie beside them
    and hold too little ground to be rated from that alone.
    """
    for path in (*space.tiles(JOINED_POINTS), *space.tiles(GROUND_SOURCE.name)):
        path.unlink()  # of an earlier run, which did not come to its end
    joined = TileSink(space.folder, JOINED_POINTS, work.columns)
    source = TileSink(space.folder, GROUND_SOURCE.name, (GROUND_SOURCE,))
    names, beside, total = [column.name for column in work.columns], part.beside(found), 0
    near = part.blocks(1)
    for key in ground.keys:
        taken = np.zeros(ground.count(key), np.bool_)
        if key in near:
            own, other = (table.read_blocks([key], names) for table in (ground, every))
            at = own["row"] - part.south, own["col"] - part.west
            unknown = (own["class_id"] == NO_CLASS) & ~is_rateable(own["thin"], own["reason"])
            taken = found[at] | (beside[at] & unknown)
            for name in names:
                own[name][taken] = other[name][taken]
            joined.add(key, own)
        source.add(key, {"col": taken, GROUND_SOURCE.name: taken})
        total += int(taken.sum())
    joined.flush()
    source.flush()
    return total
