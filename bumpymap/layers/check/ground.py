"""What the writers of a check need of a map: `bumpymap.layers` reads it from folders, tests make it up."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import DrivenStretches, DrivenTiles, Georeference
from bumpymap.layers.placement import Placement
from bumpymap.layers.route.coordinates import RouteCoordinates
from bumpymap.layers.route.source import MapSource
from bumpymap.layers.vector import GeoJsonCoordinates
from bumpytiles import Grid, TileWindow

__all__ = ["CheckGround", "CheckPlaces"]


class CheckGround(MapSource, Protocol):
    """A map whose windows can be read, and where it lies."""

    @property
    def grid(self) -> Grid:
        """The grid of tiles."""
        ...

    @property
    def georeference(self) -> Georeference:
        """CRS and units of the survey."""
        ...

    @property
    def window(self) -> TileWindow:
        """The smallest window around all tiles."""
        ...


@dataclass(frozen=True, slots=True)
class CheckPlaces:
    """Where the stretches and tiles of a check lie, for its files."""

    placement: Placement
    points: NDArray[np.float64]
    """(n, 2) easting and northing of the middles of the stretches, m; NaN where not known."""

    @classmethod
    def of(cls, stretches: DrivenStretches, tiles: DrivenTiles | None, ground: CheckGround) -> "CheckPlaces | None":
        """Return the places; None if no position of a stretch is known."""
        points = np.column_stack([stretches.easting, stretches.northing])
        known = points[np.isfinite(points).all(axis=1)]
        if not len(known):
            return None
        col, row = (ground.grid.index(known[:, axis]) for axis in (0, 1))
        if tiles is not None:
            col, row = np.concatenate([col, tiles.col]), np.concatenate([row, tiles.row])
        return cls(Placement(ground.georeference, ground.grid, TileWindow.around(col, row)), points)

    @property
    def is_known(self) -> NDArray[np.bool_]:
        """(n,) whether the position of a stretch is known."""
        return np.asarray(np.isfinite(self.points).all(axis=1), dtype=np.bool_)

    @property
    def files(self) -> GeoJsonCoordinates:
        """Longitude and latitude if the survey's CRS is known, else the survey's own coordinates."""
        return GeoJsonCoordinates.of(self.placement, local=True)

    def in_file(self) -> NDArray[np.float64]:
        """Return the middles of the stretches as GeoJSON holds them, (n, 2); NaN where not known.

        Raises
        ------
        BadInputError
            A point cannot be transformed to longitude and latitude.
        """
        found = np.full(self.points.shape, np.nan)
        coordinates = RouteCoordinates(self.placement.georeference, self.files)
        found[self.is_known] = coordinates.in_file(self.points[self.is_known])
        return found
