"""Write stretches.csv: a row for each stretch that was driven."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CheckResult, write_csv
from bumpymap.layers.check.ground import CheckPlaces
from bumpymap.layers.check.vectors import stretch_properties

__all__ = ["write_stretch_table"]


def write_stretch_table(result: CheckResult, places: CheckPlaces | None, path: Path) -> None:
    """Write the stretches as CSV (RFC 4180, UTF-8): positions, then the properties of check.geojson.

    Parameters
    ----------
    result : CheckResult
    places : CheckPlaces or None
        Where they lie; None: not known.
    path : Path
        The file, which appears only when it is complete.

    Raises
    ------
    OutputError
        The file cannot be written.
    BadInputError
        A position cannot be transformed to longitude and latitude.
    """
    columns = {**_positions(places, len(result.stretches.drive)), **stretch_properties(result)}
    write_csv(path, columns, zip(*columns.values(), strict=True))


def _positions(places: CheckPlaces | None, rows: int) -> dict[str, Sequence[Any]]:
    """Return longitude, latitude, and x and y in units of the survey's CRS."""
    unknown = np.full((rows, 2), np.nan)
    degrees, own = unknown, unknown
    if places is not None:
        own = places.points / places.placement.georeference.metres_per_unit
        degrees = unknown if places.files.to_degrees is None else places.in_file()
    return {
        **dict(zip(("lon", "lat"), _written(degrees, 7), strict=True)),
        **dict(zip(("x", "y"), _written(own, 3), strict=True)),
    }


def _written(pairs: NDArray[np.float64], decimals: int) -> list[list[str]]:
    return [["" if np.isnan(value) else f"{value:.{decimals}f}" for value in side] for side in pairs.T.tolist()]
