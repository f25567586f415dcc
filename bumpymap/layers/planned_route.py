"""Routes and reaches for notebooks: as GeoDataFrame, as xarray dataset, drawn."""

from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from bumpymap.core import Route
from bumpymap.layers._imports import import_notebook
from bumpymap.layers.placement import Placement
from bumpymap.layers.reach import ReachField
from bumpymap.layers.route_lines import route_properties

if TYPE_CHECKING:
    import geopandas
    import xarray

__all__ = ["PlannedRoute", "reach_dataset"]


class PlannedRoute(Route):
    """A way over a map, with its figures and profile."""

    __slots__ = ()

    def to_geodataframe(self) -> "geopandas.GeoDataFrame":
        """Return one row: the way as a line in the survey's CRS, and its figures as columns.

        Raises
        ------
        UsageError
            The extra ``notebook`` is not installed.
        """
        line = shapely.LineString(self.line / self.georeference.metres_per_unit)
        crs = self.georeference.crs
        flat = None if crs is None else crs.to_2d()
        return import_notebook("geopandas").GeoDataFrame([route_properties(self)], geometry=[line], crs=flat)

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Draw the way with matplotlib, in coordinates of the survey's CRS.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw it, such as over ``layers.dataset().c_r.plot()``.
        **style
            Of `geopandas.GeoDataFrame.plot`: ``color``, ``linewidth``, ...

        Returns
        -------
        matplotlib Axes
        """
        return self.to_geodataframe().plot(ax=ax, **style)

    def __repr__(self) -> str:
        found = self.figures
        return (
            f"<Route {self.name} for {self.vehicle.name}: {found.length_m:,.1f} m, cost {found.cost_m:,.1f} m, "
            f"c_r {found.c_r_mean:.3f} rad/m, P(arrives) {found.p_arrives:.3f}>"
        )


def reach_dataset(reach: ReachField) -> "xarray.Dataset":
    """Return cost and minutes of a reach on the grid of tiles, dimensions ``y`` (north first) and ``x``.

    Raises
    ------
    UsageError
        The extra ``notebook`` is not installed.
    """
    xarray = import_notebook("xarray")
    import_notebook("rioxarray")
    place = Placement(reach.georeference, reach.grid, reach.window)
    window = reach.window
    x = place.to_crs(window.col + 0.5 + np.arange(window.cols))
    y = place.to_crs(window.row + window.rows - 0.5 - np.arange(window.rows))
    variables = {"cost": (("y", "x"), reach.cost, {"units": "m", "long_name": "cost of the cheapest way"})}
    if reach.minutes is not None:
        variables["minutes"] = (("y", "x"), reach.minutes, {"units": "min", "long_name": "time along the cheapest way"})
    dataset = xarray.Dataset(variables, {"y": y, "x": x})
    return dataset if place.horizontal_crs is None else dataset.rio.write_crs(place.horizontal_crs.to_wkt())
