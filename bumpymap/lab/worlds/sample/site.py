"""A synthetic quarry with relief in closed form: ground truth for tests of measured layers."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.worlds.sample import _layout as lay
from bumpymap.lab.worlds.sample._noise import Floats
from bumpymap.lab.worlds.sample._surfaces import relief
from bumpymap.lab.worlds.sample._trees import Tree, crown_over, plant
from bumpytiles import Bounds, Grid

__all__ = ["EPSG", "ZONES", "QuarrySite", "Zone"]

Zone = Literal[
    "transition",
    "floor",
    "meadow",
    "bank",
    "rubble",
    "stockpile",
    "pond",
    "pad",
    "step",
    "ramp",
    "road",
    "washboard",
    "ruts",
    "outside",
]
ZONES: tuple[Zone, ...] = get_args(Zone)
"""'transition' is the blend between two surfaces; 'outside' is beyond the site."""
EPSG = 32632
"""CRS of the site: WGS 84 / UTM zone 32N, metres. The location is arbitrary."""

_CORNER = (512_340.0, 5_403_210.0)


@dataclass(frozen=True, slots=True)
class QuarrySite:
    """A quarry of 126 x 102 m: road, washboard, ruts, rubble, pad with kerb, ramp, bench wall, meadow, pond, trees.

    The seed changes stones, waves and trees, but not the zones.
    """

    seed: int = 1

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}; it must be zero or more")

    @property
    def bounds(self) -> Bounds:
        """Extent of the site, m; a whole number of 3 m tiles."""
        west, south = _CORNER
        return Bounds(west, south, west + lay.EAST_WEST, south + lay.NORTH_SOUTH)

    @property
    def trees(self) -> tuple[Tree, ...]:
        """The trees; their crowns do not belong to the ground."""
        return _trees(self.seed)

    def height(self, easting: Floats, northing: Floats) -> Floats:
        """Height of the bare ground.

        Parameters
        ----------
        easting, northing : array float64
            m; shapes must broadcast.

        Returns
        -------
        array float64
            Upward, m, without trees. Continuous except at the kerb of the pad.
        """
        x, y = _local(easting, northing)
        return relief(self.seed, x.ravel(), y.ravel()).reshape(x.shape)

    def is_water(self, easting: Floats, northing: Floats) -> NDArray[np.bool_]:
        """Return True in the pond, where surveys have no points."""
        return lay.outside_pond(*_local(easting, northing)) <= 0.0

    def zone_at(self, easting: Floats, northing: Floats) -> NDArray[np.str_]:
        """Return the zone at each position, one of ``ZONES``."""
        x, y = _local(easting, northing)
        return np.array(ZONES)[_zone_code(x, y)]

    def zone_bounds(self, zone: Zone) -> Bounds:
        """Return the bounding box of a zone, in steps of 0.25 m (the two meadows share one)."""
        x, y = np.meshgrid(np.arange(0.125, lay.EAST_WEST, 0.25), np.arange(0.125, lay.NORTH_SOUTH, 0.25))
        line, column = np.nonzero(_zone_code(x, y) == ZONES.index(zone))
        if line.size == 0:
            raise ValueError(f"the site has no zone '{zone}'; choose one of {', '.join(ZONES[:-1])}")
        west, south = _CORNER
        return Bounds(
            west + 0.25 * int(column.min()),
            south + 0.25 * int(line.min()),
            west + 0.25 * (int(column.max()) + 1),
            south + 0.25 * (int(line.max()) + 1),
        )

    def tiles_inside(self, zone: Zone, grid: Grid | None = None) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the tiles that lie wholly inside one zone and not under a tree.

        Parameters
        ----------
        zone : Zone
        grid : Grid, optional
            Tiles of 3 m by default.

        Returns
        -------
        col, row : array (k,) int64
            Tested at 31 x 31 positions of each tile, including its edges.
        """
        size = (grid or Grid()).tile_size
        box = self.bounds
        col, row = np.meshgrid(
            np.arange(np.floor(box.west / size), np.ceil(box.east / size)),
            np.arange(np.floor(box.south / size), np.ceil(box.north / size)),
        )
        west, south = col.ravel() * size, row.ravel() * size
        for places in (3, 31):  # coarse test first, which excludes most tiles
            inner = np.linspace(0.0, size, places) * (1.0 - 1e-9)
            easting, northing = np.broadcast_arrays(
                west[:, None, None] + inner[None, None, :], south[:, None, None] + inner[None, :, None]
            )
            within = np.all(_zone_code(*_local(easting, northing)) == ZONES.index(zone), axis=(1, 2))
            west, south = west[within], south[within]
        clear = np.all(crown_over(self.trees, easting[within], northing[within])[2] < 0, axis=(1, 2))
        return np.rint(west[clear] / size).astype(np.int64), np.rint(south[clear] / size).astype(np.int64)


def _local(easting: Floats, northing: Floats) -> tuple[Floats, Floats]:
    """Return coordinates relative to the south-west corner, m, broadcast to a common shape."""
    x, y = np.broadcast_arrays(np.asarray(easting, np.float64), np.asarray(northing, np.float64))
    return x - _CORNER[0], y - _CORNER[1]


@lru_cache(maxsize=8)
def _trees(seed: int) -> tuple[Tree, ...]:
    return plant(seed, _CORNER, lambda x, y: _zone_code(x, y) == ZONES.index("meadow"))


def _zone_code(x: Floats, y: Floats) -> NDArray[np.int64]:
    """Return the index into ``ZONES``; later features cover earlier ones, like their surfaces."""
    code = np.full(x.shape, ZONES.index("floor"), dtype=np.int64)
    north, offset, pad = lay.along_bank(x, y), lay.road_offset(x, y), lay.outside_box(x, y, lay.PAD)

    def paint(zone: Zone, core: NDArray[np.bool_], around: NDArray[np.bool_] | None = None) -> None:
        if around is not None:
            code[around] = ZONES.index("transition")
        code[core] = ZONES.index(zone)

    paint("meadow", offset < -lay.ROAD_HALF_WIDTH)
    paint("bank", (north > 0.0) & (north < lay.BANK_WIDTH), (north > -4.0) & (north < lay.BANK_WIDTH + 0.5))
    paint("meadow", north >= lay.BANK_WIDTH + 0.5)
    rubble, heap, pond = lay.outside_rubble(x, y), lay.outside_stockpile(x, y), lay.outside_pond(x, y)
    paint("stockpile", heap <= -0.5, heap < 0.5)
    paint("rubble", rubble <= 0.0, (rubble < 5.0) & (north <= 0.0))
    paint("pond", pond <= 0.0, pond < lay.BLEND["pond"])
    paint("pad", pad < -lay.KERB_BAND, pad < lay.BLEND["pad"])
    paint("step", np.abs(pad) <= lay.KERB_BAND)
    ramp, spur = lay.outside_ramp(x, y), lay.outside_spur(x, y)
    paint("ramp", lay.outside_box(x, y, lay.RAMP) <= 0.0, ramp < lay.BLEND["ramp"])
    graded = (spur <= 0.0) & (y < lay.RAMP[1] - 3.0)
    paint("road", graded, (spur < lay.BLEND["spur"]) & (ramp > 0.0))
    core = np.abs(offset) <= lay.ROAD_HALF_WIDTH
    shoulder = np.abs(offset) < lay.ROAD_HALF_WIDTH + lay.BLEND["road"]
    paint("road", core, shoulder)
    sections: tuple[tuple[Zone, tuple[float, float]], ...] = (("washboard", lay.WASHBOARD), ("ruts", lay.RUTS))
    for zone, (west, east) in sections:
        paint(zone, core & (x >= west) & (x <= east), core & (x > west - 4.0) & (x < east + 4.0))
    paint("outside", (x < 0.0) | (x >= lay.EAST_WEST) | (y < 0.0) | (y >= lay.NORTH_SOUTH))
    return code
