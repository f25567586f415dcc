"""Read a vector file of a user's: geometries, names and CRS."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from bumpymap.core import BadInputError

__all__ = ["VectorLayer", "layers_in", "read_vectors"]


@dataclass(frozen=True, slots=True)
class VectorLayer:
    """One layer of a vector file."""

    geometry: NDArray[np.object_]
    """(n,) shapely geometries in two dimensions, of the features that have one."""
    names: tuple[str, ...]
    """(n,) of the field ``name``; empty strings without one."""
    crs: CRS | None
    """As the file states it."""


def layers_in(path: Path) -> list[str]:
    """Return the names of the layers of a file that can hold geometries.

    Raises
    ------
    BadInputError
        The file is missing, or no vector file.
    """
    import pyogrio

    try:
        return [str(name) for name, kind in pyogrio.list_layers(path) if kind is not None]
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError) as error:
        raise _unreadable(path, error) from error


def read_vectors(path: Path, layer: str | None = None) -> VectorLayer:
    """Read a layer of a vector file, by default its only one.

    Raises
    ------
    BadInputError
        The file is missing, damaged or no vector file, or it has several layers and none is named.
    """
    import pyogrio
    from pyogrio.raw import read

    if layer is None:
        found = layers_in(path)
        if len(found) != 1:
            listed = ", ".join(found) or "none"
            raise BadInputError(f"{path} must hold one layer of geometries; it holds: {listed}. Save one by itself")
        layer = found[0]
    errors = (
        pyogrio.errors.DataSourceError,
        pyogrio.errors.DataLayerError,
        pyogrio.errors.FeatureError,
        pyogrio.errors.FieldError,
        pyogrio.errors.GeometryError,
        shapely.errors.GEOSException,
        CRSError,
        ValueError,
    )
    try:
        with warnings.catch_warnings(action="ignore"):  # such as of rings that do not end where they began
            about, _, wkb, columns = read(path, layer=layer, columns=["name"], force_2d=True)
        geometry = shapely.from_wkb(wkb)
        crs = None if about["crs"] is None else CRS.from_user_input(about["crs"])
    except errors as error:
        raise _unreadable(path, error) from error
    held = ~(shapely.is_missing(geometry) | shapely.is_empty(geometry))
    names = columns[0] if len(columns) else np.full(len(geometry), "", object)
    return VectorLayer(geometry[held], _texts(names[held]), crs)


def _texts(names: Sequence[object] | NDArray[np.object_]) -> tuple[str, ...]:
    missing = (None, "")
    return tuple("" if name in missing or name != name else str(name).strip() for name in names)  # noqa: PLR0124 (NaN)


def _unreadable(path: Path, error: BaseException) -> BadInputError:
    import pyogrio

    remedy = "Give a vector file such as GeoJSON, which a GIS can save"
    if isinstance(error, pyogrio.errors.DataSourceError):  # GDAL's text advises on its own command line
        return BadInputError(f"cannot read {path}: it is no vector file, or it is damaged. {remedy}")
    return BadInputError(f"cannot read {path}: {error}. {remedy}")
