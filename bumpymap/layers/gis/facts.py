"""What styles depend on beside the table of colours: the classes of the vehicle, units."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.errors import RasterioError

from bumpymap.core import CLASS_NAMES, OutputError
from bumpymap.layers.map_files import open_layer
from bumpymap.layers.ride_scale import OR_FAILS, RideScale, class_limits
from bumpymap.layers.sheets.folders import raster_in

__all__ = ["StyleFacts"]

_SAMPLE = 512
"""Most rows and columns of roughness.tif to read where the record has no limits of the classes."""


@dataclass(frozen=True, slots=True)
class StyleFacts:
    """Classes, colours of the ride cost and units of one map."""

    intervals: tuple[str, ...] | None
    """(4,) c_r of each class for the vehicle; None where the record has no limits of the classes."""
    by_c_r: bool
    """Whether the intervals decide the class; False under the rules of the paper."""
    scale: RideScale
    z_factor: float
    """Units of the CRS in a metre, which is the unit of all heights."""
    speeds: tuple[float, ...] = ()
    """Of speeds.tif, m/s, in the order of its bands."""

    @classmethod
    def of(cls, folder: Path, record: Mapping[str, Any]) -> "StyleFacts":
        """Read them from the record of a run; c_r of its layers only if the record has no limits of the classes.

        Raises
        ------
        OutputError
            roughness.tif cannot be read.
        """
        limits = class_limits(record)
        sample = np.empty(0) if limits else _c_r_sample(raster_in(folder, "roughness.tif"))
        units = record.get("metres_per_unit")
        metres = units.get("horizontal") if isinstance(units, Mapping) else None
        return cls(
            None if limits is None else _intervals(limits),
            _setting(record, "compat") != "paper",
            RideScale.of(record, sample),
            1.0 / metres if isinstance(metres, int | float) and metres > 0 else 1.0,
            tuple(float(speed) for speed in _setting(record, "speeds") or ()),
        )

    @property
    def class_labels(self) -> tuple[str, ...]:
        """(4,) what a legend says for each class: its name and, where it decides, its interval of c_r."""
        if self.intervals is None or not self.by_c_r:
            return CLASS_NAMES
        named = [f"{name}: c_r {text}" for name, text in zip(CLASS_NAMES, self.intervals, strict=True)]
        return (*named[:-1], f"{named[-1]}{OR_FAILS}")

    @property
    def ride_labels(self) -> tuple[str, ...]:
        """(4,) what a legend says for the colour of each class in a picture of c_r."""
        if self.intervals is None:
            return tuple(f"{anchor:.3g} rad/m" for anchor in self.scale.anchors)
        return tuple(f"{text} ({name})" for name, text in zip(CLASS_NAMES, self.intervals, strict=True))


def _intervals(limits: list[float]) -> tuple[str, ...]:
    texts = [f"{limit:.3g}" for limit in limits]
    between = [f"{low} to {high} rad/m" for low, high in pairwise(["0", *texts])]
    return (*between, f"from {texts[-1]} rad/m")


def _setting(record: Mapping[str, Any], name: str) -> Any:
    """Return a setting of a run, or None; settings are a dataclass until they are written, then an object of JSON."""
    settings = record.get("settings")
    return settings.get(name) if isinstance(settings, Mapping) else getattr(settings, name, None)


def _c_r_sample(path: Path) -> NDArray[np.float32]:
    """Return the first band of a raster, the ride cost, from an overview if it is large."""
    try:
        with open_layer(path) as raster:
            shape = (min(raster.height, _SAMPLE), min(raster.width, _SAMPLE))
            return np.asarray(raster.read(1, out_shape=shape), dtype=np.float32)
    except RasterioError as error:
        raise OutputError(f"cannot read {path} to choose the colours of its style: {error}") from error
