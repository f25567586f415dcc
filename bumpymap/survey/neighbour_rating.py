"""What the neighbours of a tile change: the step of `bumpymap.survey.second_pass` that a run applies to every block."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    FAIL_SHARE,
    FREE,
    NO_CLASS,
    OBSTACLE,
    SIDES,
    UNDECIDED,
    UNSEEN,
    Barred,
    Compat,
    MapConfig,
    Rating,
    Reason,
    neighbour_columns,
)
from bumpymap.rating import (
    BlockRating,
    Calibration,
    TileSteps,
    apply_steps,
    crossing_fails,
    dense_share,
    edge_usable,
    find_passable,
    find_steps,
    is_rateable,
    motion_felt,
    rate_thin,
    settle_objects,
)
from bumpymap.survey.second_pass import RING, NeighbourWindow
from bumpymap.survey.tile_rating import RatingModels
from bumpytiles import Column, Grid

__all__ = ["NeighbourRating"]

Columns = dict[str, NDArray[Any]]
_RATED = ("class_id", "c_r", "c_r_low", "c_r_high", "p_fail", "confidence", "reason")
_BESIDE = ((-1, 0), (0, 1), (1, 0), (0, -1))
"""Rows and columns to the tile beyond each side; rows go south."""
_LEAST_PIXELS = 10
"""With fewer pixels along the side of a tile, steps are not told."""


@dataclass(frozen=True, slots=True)
class NeighbourRating:
    """Rates the tiles of a block with their neighbours: thin tiles, steps, and ways between obstacles."""

    grid: Grid
    calibration: Calibration
    rating: Rating
    compat: Compat
    speeds: tuple[float, ...] = ()
    """Speeds besides that of the map, m/s."""

    @classmethod
    def of(cls, config: MapConfig, models: RatingModels) -> "NeighbourRating":
        """Choose the steps that the settings ask for."""
        speeds = config.speeds or ()
        return cls(Grid(config.tile_size, config.pixels), models.calibration, config.rating, config.compat, speeds)

    @property
    def needs(self) -> tuple[str, ...]:
        """Columns of the finished tiles that it reads."""
        return (*_RATED, "slope", "coverage", "heights", "objects", "obstacle", "thin", *self._motion)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns that it returns."""
        return neighbour_columns(self.grid.pixels, len(self.speeds))

    @property
    def _motion(self) -> tuple[str, ...]:
        """The column of other speeds, if they were asked for."""
        return ("motion",) if self.speeds else ()

    @property
    def rates_thin(self) -> bool:
        """Whether thin tiles are rated from their points."""
        return self.rating == "ride" and self.compat == "none" and self.calibration.thin is not None

    def leaves(self, own: Mapping[str, NDArray[Any]]) -> Columns | None:
        """Return the columns of n tiles of a block if all are unknown and stay so; None if neighbours matter.

        Parameters
        ----------
        own : mapping
            ``needs`` without ``heights``, (n, ...) each.
        """
        if (own["class_id"] != NO_CLASS).any() or (self.rates_thin and self._known(own).any()):
            return None
        tiles = len(own["class_id"])
        nothing = np.full(tiles, np.nan, np.float32)
        objects = np.where(own["objects"] == UNDECIDED, np.uint8(FREE), own["objects"])
        return (
            {name: own[name] for name in (*_RATED, "obstacle", *self._motion)}
            | dict.fromkeys(("edge_step", "inner_step", *(f"step_{side}" for side in SIDES)), nothing)
            | {"barred": np.full(tiles, Barred.UNKNOWN, np.uint8), "passable": np.zeros(tiles, np.uint8)}
            | {"objects": objects}
        )

    def __call__(self, window: NeighbourWindow) -> Columns:
        """Return `neighbour_columns` of the inner tiles."""
        own = {name: window.inner(name) for name in (*_RATED, "slope", "coverage", "obstacle")}
        known = self._known(window.columns)
        if self.rates_thin:
            own |= asdict(
                rate_thin(window["thin"], _first(window), window["coverage"], window["slope"], self.calibration)
            )
        objects = settle_objects(window.mosaic("objects"), self.grid.pixels)
        objects[(objects == FREE) & ~self._pixels(known)] = UNSEEN
        steps = self._steps(window)
        if self.compat == "none":
            # Few points make steps of rough ground: in thin tiles they bar the way, but do not change the ride.
            share = dense_share(own["coverage"]) if self.rates_thin else 1.0
            own |= apply_steps(own, steps.unseen * share, self.calibration)
            barred = self._sweep(own, known, objects, steps)
        else:
            barred = self.calibration.cost_rule.barred(own)
        states = self._inner(objects)
        obstacle = np.mean(states == OBSTACLE, axis=(2, 3), dtype=np.float32)
        return (
            {name: own[name] for name in _RATED}
            | _by_side(steps)
            | {"barred": barred, "passable": (barred == Barred.NO).astype(np.uint8)}
            | {"objects": states, "obstacle": np.where(np.isnan(own["obstacle"]), np.float32(np.nan), obstacle)}
            | {name: self._felt(window.inner(name), own["c_r"]) for name in self._motion}
        )

    def _felt(self, factors: NDArray[np.float32], c_r: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return what is felt at other speeds, (16, 16, 3 k), from the factors on C_r; NaN in unknown tiles."""
        return motion_felt(self.calibration, self.speeds, factors, c_r)

    def _known(self, columns: Mapping[str, NDArray[Any]]) -> NDArray[np.bool_]:
        """Return which tiles have a class, or will have one."""
        known: NDArray[np.bool_] = columns["class_id"] != NO_CLASS
        return known | is_rateable(columns["thin"], columns["reason"]) if self.rates_thin else known

    def _steps(self, window: NeighbourWindow) -> TileSteps:
        if self.grid.pixels >= _LEAST_PIXELS:
            return find_steps(window.mosaic("heights"), self.grid.pixels, self.calibration.wheel_pixels)
        rows, cols = window.inner("class_id").shape
        px = self.grid.pixels
        shapes = ((rows, cols, len(SIDES)), (rows, cols), (rows, cols), (rows * px, cols * px))
        return TileSteps(*(np.full(shape, np.nan, np.float32) for shape in shapes))

    def _sweep(
        self, own: Mapping[str, NDArray[Any]], known: NDArray[np.bool_], objects: NDArray[np.uint8], steps: TileSteps
    ) -> NDArray[np.uint8]:
        """Return what bars the inner tiles."""
        alone = self.calibration.cost_rule.barred(own)
        crossed = _crossed(edge_usable(steps.border, self.calibration), np.isnan(steps.border), known)
        barred = find_passable(objects, alone, crossed, self.calibration.body, self.grid.tile_size)
        # The rating sees a wall as a ramp between two pixels, which is easier to climb. A wall on a border bars both of
        # its tiles, or a way over the cost layer, which knows no borders, would cross it.
        fails = crossing_fails(np.fmax(steps.inner, steps.edge_step), self.calibration) >= FAIL_SHARE
        barred[(barred == Barred.NO) & fails] = Barred.STEP
        return barred

    def _pixels(self, of_tiles: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Give every pixel of a mosaic the value of its tile."""
        return np.repeat(np.repeat(of_tiles, self.grid.pixels, axis=0), self.grid.pixels, axis=1)

    def _inner(self, mosaic: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Cut the inner tiles out of a mosaic, (16, 16, pixels, pixels)."""
        px = self.grid.pixels
        tiles = len(mosaic) // px
        apart = mosaic.reshape(tiles, px, tiles, px).swapaxes(1, 2)
        return apart[RING:-RING, RING:-RING]


def _first(window: NeighbourWindow) -> BlockRating:
    """Return what the first pass found."""
    columns = {name: window[name] for name in _RATED}
    missing = np.where(window.present, columns.pop("reason"), np.uint8(Reason.NO_POINTS))
    return BlockRating(**columns, reason=missing)


def _crossed(
    usable: NDArray[np.bool_], unseen: NDArray[np.bool_], known: NDArray[np.bool_]
) -> NDArray[np.bool_]:  # fmt: skip
    """Return which sides of the inner tiles the vehicle can cross, (16, 16, 4).

    Where nobody saw a step, such as in a thin survey, none is assumed between known tiles: the rating of both tiles
    holds what their points tell. A side without a known tile beyond it leads nowhere, but does not bar a tile of which
    no neighbour is known.
    """
    rows, cols = (side - 2 * RING for side in known.shape)
    beyond = np.stack(
        [known[RING + down : RING + down + rows, RING + right : RING + right + cols] for down, right in _BESIDE],
        axis=-1,
    )
    alone = ~beyond.any(axis=-1, keepdims=True)
    return np.asarray((beyond & (usable | unseen)) | alone)


def _by_side(steps: TileSteps) -> Columns:
    by_side = {f"step_{side}": steps.border[..., number] for number, side in enumerate(SIDES)}
    return by_side | {"edge_step": steps.edge_step, "inner_step": steps.inner}
