"""Read a vector file with GDAL, in a child process: see `bumpymap.layers.map_files.read_features`.

The process imports nothing of bumpymap. Pandas and its like, which pyogrio would import if they are there, are hidden
from it: that would take half a second.
"""

import os
import re
import sqlite3
import sys
import warnings
from collections.abc import Collection
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

_PLAIN = re.compile(
    r"CREATE (TABLE|INDEX|UNIQUE INDEX|TRIGGER)\b.*"
    r'|CREATE VIRTUAL TABLE "rtree_([^"]|"")*" USING rtree\([^()]*\)',
    re.DOTALL | re.IGNORECASE,
)
"""Parts of a database that hold what they give. Views and virtual tables compute it, from other files too."""

os.chdir("/")  # PROJ looks for its settings in the current folder, which may be that of strangers
sys.modules |= dict.fromkeys(("geopandas", "pandas", "pyarrow"))  # type: ignore[arg-type]  # None: not to be imported


def vector_drivers() -> list[str]:
    """Return the names of the vector formats that GDAL reads here."""
    import pyogrio

    return sorted(pyogrio.list_drivers())


def read(
    path: str, columns: Collection[str] | None, drivers: Collection[str]
) -> tuple[str | None, Any, dict[str, Any]]:
    """Return the CRS, the geometries as WKB and the columns of the only layer of geometries; ValueError if damaged.

    ``columns``: names of those that are read, where they are there; None: all; ``drivers``: the only ones that GDAL may
    have.
    """
    import pyogrio
    from pyogrio.raw import read as read_layer

    if not set(vector_drivers()) <= set(drivers):
        raise RuntimeError("GDAL has other drivers here")
    file = Path(path)  # of a text pyogrio would take apart what may be a URL or an archive
    if file.suffix.lower() == ".gpkg":
        _require_plain(file)
    try:
        with warnings.catch_warnings(action="ignore"):  # such as of rings that do not end where they began
            layers = [str(name) for name, kind in pyogrio.list_layers(file) if kind is not None]
            if len(layers) != 1:
                raise ValueError(f"it must hold one layer of geometries; it holds: {', '.join(layers) or 'none'}")
            about, _, geometry, values = read_layer(file, layer=layers[0], columns=columns, force_2d=True)
    except (pyogrio.errors.DataSourceError, UnboundLocalError) as error:
        # GDAL's text gives advice on GDAL; UnboundLocalError is pyogrio's where the CRS is no text.
        raise ValueError("it is damaged") from error
    return about["crs"], np.asarray(geometry, object), dict(zip(about["fields"].tolist(), values, strict=True))


def _require_plain(path: Path) -> None:
    """Raise ValueError if a database computes what is read of it, or cannot be read."""
    try:
        with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)) as database:
            parts = database.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL").fetchall()
    except sqlite3.Error as error:
        raise ValueError(f"it is damaged ({error})") from error
    for name, text in parts:
        if not _PLAIN.fullmatch(str(text)):
            raise ValueError(f"its part {name!r} is computed when it is read, perhaps from other files")
