"""Map surveys from Python: one call that returns the layers."""

import os
import shutil
from collections.abc import Collection, Iterable, Mapping, Sequence
from numbers import Integral
from pathlib import Path
from typing import Any, TypeAlias, TypedDict, Unpack

from bumpymap.core import (
    CLASHES,
    Align,
    Compat,
    CsfSettings,
    FeatureSettings,
    Ground,
    MapConfig,
    Rating,
    UsageError,
    ZUnit,
    path_of_call,
    refuse_clashes,
    settings_of_call,
    short_repr,
)
from bumpymap.layers import Layers, temporary_folder
from bumpymap.survey.advice import require_known
from bumpymap.survey.pipeline import map_surveys

__all__ = ["EachSettings", "MapSettings", "PathLike", "map_settings", "map_survey"]

PathLike: TypeAlias = str | os.PathLike[str]


class EachSettings(TypedDict, total=False):
    """Settings of a map, be it of one survey or of many: fields of ``MapConfig``; paths may be strings."""

    tile_size: float
    pixels: int
    ground: Ground
    align: Align
    rating: Rating
    compat: Compat
    vehicle: PathLike
    calibration: PathLike | None
    speed: float | None
    speeds: Sequence[float] | None
    model: PathLike | None
    crs: str | int | None
    force_crs: str | int | None
    z_unit: ZUnit | None
    local: bool
    trust_points: bool
    skip_bad: bool
    max_unknown: float | None
    sheets: float | None
    overwrite: bool
    threads: int
    memory: str
    scratch: PathLike | None
    scheduler: str | None
    features: FeatureSettings | Mapping[str, Any]
    csf: CsfSettings | Mapping[str, Any]


class MapSettings(EachSettings, total=False):
    """Settings of `map_survey`: the fields of ``MapConfig``, as it describes them."""


def map_survey(
    surveys: PathLike | Iterable[PathLike], out: PathLike | None = None, **settings: Unpack[MapSettings]
) -> Layers:
    """Map surveys: roughness, classes and ride cost of each tile.

    Parameters
    ----------
    surveys : path, or several
        Files and folders (LAS, LAZ, COPC, PLY, PCD), or URLs; strings or path-like objects.
    out : path, optional
        Folder for the layers. Without one they are temporary, and deleted with the returned object.
    **settings
        Those of ``bumpymap map``, with underscores: ``tile_size`` [m], ``pixels``, ``ground``, ``align``, ``rating``,
        ``compat``, ``vehicle``, ``calibration``, ``speed`` [m/s], ``speeds`` [m/s], ``model``, ``crs``, ``force_crs``,
        ``z_unit``, ``local``, ``trust_points``, ``skip_bad``, ``max_unknown``, ``sheets`` [km], ``overwrite``,
        ``threads``, ``memory``, ``scratch``, ``scheduler``; ``features`` and ``csf`` are dicts, the tables
        of a settings file.

    Returns
    -------
    Layers

    Raises
    ------
    BumpymapError
        Bad inputs or settings, or a full disk; no file is left half-written.
    TooUnknownError
        More tiles are unknown than ``max_unknown`` allows; the layers in ``out`` are complete.

    Examples
    --------
    >>> import bumpymap
    >>> layers = bumpymap.map_survey("sample_data/quarry.laz", ground="all")
    >>> layers.manifest["counts"]["by_class"]["smooth"] > 500
    True
    """
    own = map_settings(settings, "map_survey", MapSettings.__annotations__)
    places = _places(surveys)
    if out is not None:
        folder = path_of_call("out", out)
        if "://" in folder:
            raise UsageError(f"out is {folder}, a URL; bumpymap.map_batch uploads layers, each survey to a folder")
        _map(MapConfig(surveys=places, out=Path(folder), **own))
        return Layers(folder)
    if own.get("sheets") is not None:
        raise UsageError(
            f"`sheets={own['sheets']:g}` cuts a large map into folders, and layers without `out` are temporary: give "
            "`out='DIR'`, or leave sheets out"
        )
    folder = temporary_folder()
    try:
        _map(MapConfig(surveys=places, out=Path(folder), **own))
        return Layers(folder, in_memory=True)
    except BaseException as end:
        shutil.rmtree(folder, ignore_errors=True)
        end.__notes__ = [
            note for note in getattr(end, "__notes__", []) if "the same again" not in note
        ]  # the temporary folder is deleted, so there is nothing to resume
        raise


def _map(config: MapConfig) -> None:
    require_known(map_surveys(config), config)


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


def _places(surveys: PathLike | Iterable[PathLike]) -> tuple[Path | str, ...]:
    """Convert one path or several to Path objects; URLs stay strings."""
    several = [surveys] if isinstance(surveys, str | os.PathLike) else surveys
    if not isinstance(several, Iterable):
        raise UsageError(f"surveys is {short_repr(several)}; give a path or a list of them")
    texts = [path_of_call("surveys", survey) for survey in several]
    if not texts:
        raise UsageError("surveys is empty; give a path or a list of them")
    return tuple(text if "://" in text else Path(text) for text in texts)
