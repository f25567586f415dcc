"""Settings of a map as keywords of a Python call."""

import os
from collections.abc import Collection, Mapping, Sequence
from numbers import Integral
from pathlib import Path
from typing import Any, TypeAlias, TypedDict

from bumpymap.core import (
    CLASHES,
    Align,
    Compat,
    CsfSettings,
    FeatureSettings,
    Ground,
    LengthUnit,
    MapConfig,
    PageSettings,
    Rating,
    UsageError,
    path_of_call,
    refuse_clashes,
    settings_of_call,
    short_repr,
)

PathLike: TypeAlias = str | os.PathLike[str]


class EachSettings(TypedDict, total=False):
    """Settings of a map, be it of one survey or of many: fields of ``MapConfig``; paths may be strings."""

    tile_size: float
    pixels: int
    ground: Ground
    ground_classes: Sequence[int]
    align: Align
    rating: Rating
    compat: Compat
    vehicle: PathLike
    calibration: PathLike | None
    speed: float | None
    headings: bool
    model: PathLike | None
    crs: str | int | None
    force_crs: str | int | None
    xy_unit: LengthUnit | None
    z_unit: LengthUnit | None
    local: bool
    trust_points: bool
    skip_bad: bool
    max_unknown: float | None
    overwrite: bool
    threads: int
    memory: str
    scratch: PathLike | None
    scheduler: str | None
    provider: str
    license: str
    features: FeatureSettings | Mapping[str, Any]
    csf: CsfSettings | Mapping[str, Any]
    page: PageSettings | Mapping[str, Any]


class MapSettings(EachSettings, total=False):
    """Settings of `map_survey`: the fields of ``MapConfig``, as it describes them."""


def folder_of_call(name: str, place: PathLike) -> Path:
    """Return the output folder that a Python call gives; raise UsageError if it is not a valid path."""
    return Path(path_of_call(name, place))


def map_settings(settings: Mapping[str, Any], function: str, known: Collection[str]) -> dict[str, Any]:
    """Check the keyword arguments of a call for the fields of ``MapConfig``; ``known`` are all that it has."""
    given = dict(settings)
    for name in ("crs", "force_crs"):
        crs = given.get(name)
        if isinstance(crs, Integral) and not isinstance(crs, bool):
            given[name] = f"EPSG:{crs}"
        elif crs is not None and not isinstance(crs, str):
            raise UsageError(
                f"{name} is {short_repr(crs)}; give a code such as {name}='EPSG:32614', a PROJ string or WKT"
            )
    own = settings_of_call(given, MapConfig, function, known)
    refuse_clashes(own, CLASHES)
    return own
