"""The positions of a drive on the grid of a map."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.check.places import MetrePlaces, local_metres, metre_places
from bumpymap.core import BadInputError, DriveLog, PlaceTrack, describe_crs
from bumpymap.layers import RouteMap

__all__ = ["places_alone", "places_on_map"]

Floats = NDArray[np.float64]

_LEAST_INSIDE = 0.02
"""With a smaller share of its positions in the extent of the map, a drive was somewhere else."""


def places_alone(log: DriveLog) -> MetrePlaces | None:
    """Return the positions of a drive in metres, from any zero; None if it has none."""
    track = log.places
    if track is None:
        return None
    metres = local_metres(track.x, track.y) if track.kind == "lonlat" else (track.x, track.y)
    return metre_places(track, *metres, log.name)


def places_on_map(log: DriveLog, site: RouteMap) -> MetrePlaces:
    """Return the positions of a drive on the grid of a map, m.

    Raises
    ------
    BadInputError
        There are none, they do not say where on Earth they are, or they lie off the map.
    """
    track = log.places
    if track is None:
        raise BadInputError(
            f"{log.name} has no positions, so it is not known which part of the map was driven. Give the log of the "
            "receiver with it (files of one drive are joined by commas), name its columns with `columns`, or leave "
            "out the layers to measure the drive alone"
        )
    if track.kind == "local":
        raise BadInputError(
            f"{log.name} has positions of odometry alone, which do not say where on the map they are. Give longitude "
            "and latitude or coordinates of the map's CRS, or leave out the layers to measure the drive alone"
        )
    if track.kind == "lonlat" and not site.has_crs:
        raise BadInputError(
            f"{log.name} has longitude and latitude, but the map has no CRS. Map the survey with `crs='EPSG:CODE'`, or "
            "give positions in the survey's own coordinates"
        )
    convert = site.from_lonlat if track.kind == "lonlat" else site.to_grid
    places = metre_places(track, *convert(track.x, track.y), log.name)
    _refuse_off_map(log.name, track, places, site)
    return places


def _refuse_off_map(name: str, track: PlaceTrack, places: MetrePlaces, site: RouteMap) -> None:
    size, window = site.grid.tile_size, site.window
    west, south = window.col * size, window.row * size
    east, north = west + window.cols * size, south + window.rows * size
    inside = (places.place.real > west) & (places.place.real < east)
    inside &= (places.place.imag > south) & (places.place.imag < north)
    if inside.mean() > _LEAST_INSIDE:
        return
    if track.kind == "lonlat":
        where = f"around longitude {_middle(track.x, 5)}, latitude {_middle(track.y, 5)}"
        lon, lat = site.to_lonlat(np.array([west, east]), np.array([south, north]))
        there = f"longitude {lon[0]:.5f} to {lon[1]:.5f}, latitude {lat[0]:.5f} to {lat[1]:.5f}"
        remedy = "Check that longitude and latitude are not exchanged, and that it is the drive of this site"
    else:
        where = f"around {_middle(track.x, 1)}, {_middle(track.y, 1)}"
        ends = site.to_crs(np.array([west, east]), np.array([south, north]))
        (x0, x1), (y0, y1) = ends
        crs = site.georeference.crs
        there = f"{x0:.1f} to {x1:.1f}, {y0:.1f} to {y1:.1f}" + (f" in {describe_crs(crs)}" if crs is not None else "")
        remedy = "Give positions in the CRS of the map, or longitude and latitude"
    raise BadInputError(f"{name} is off the map: the drive lies {where}; the map covers {there}. {remedy}")


def _middle(values: Floats, digits: int) -> str:
    return f"{float(np.nanmedian(values)):.{digits}f}"
