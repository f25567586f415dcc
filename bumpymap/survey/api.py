"""Map surveys from Python: one call that returns the layers."""

import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
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
    path_fault,
    refuse_clashes,
    settings_of_call,
)
from bumpymap.layers import Layers, temporary_folder
from bumpymap.survey.end_of_run import require_known
from bumpymap.survey.pipeline import map_surveys

__all__ = ["EachSettings", "MapSettings", "PathLike", "map_survey", "place_text"]

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
    crs: str | None
    force_crs: str | None
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
    workers: int | None
    scheduler: str | None
    tls_config: PathLike | None
    features: FeatureSettings | Mapping[str, Any]
    csf: CsfSettings | Mapping[str, Any]


class MapSettings(EachSettings, total=False):
    """Settings of `map_survey`: the fields of ``MapConfig``, as it describes them."""

    resume: bool


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
        ``compat``, ``vehicle``, ``calibration``, ``model``, ``crs``, ``force_crs``, ``z_unit``, ``local``,
        ``trust_points``, ``skip_bad``, ``max_unknown``, ``sheets`` [km], ``overwrite``, ``resume``, ``threads``,
        ``memory``, ``scratch``, ``workers``, ``scheduler``, ``tls_config``; ``features`` and ``csf`` are dicts, the
        tables of a settings file.

    Returns
    -------
    Layers

    Raises
    ------
    BumpymapError
        Bad inputs or settings, or a full disk; no file is left half-written.
    TooUnknownError
        More tiles are unknown than ``max_unknown`` allows; the layers in ``out`` are complete.
    TypeError
        There is no setting of this name.

    Examples
    --------
    >>> import bumpymap
    >>> layers = bumpymap.map_survey("sample_data/quarry.laz", ground="all")
    >>> layers.manifest["counts"]["by_class"]["smooth"] > 500
    True
    """
    _refuse_unknown(settings)
    given = {name: value for name, value in settings.items() if value is not None}
    refuse_clashes(given, CLASHES)
    own = settings_of_call(given, MapConfig, "map_survey")
    places = _places(surveys)
    if out is not None:
        folder = place_text("out", out)
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
            note for note in getattr(end, "__notes__", []) if "`resume=True`" not in note
        ]  # the temporary folder is deleted, so there is nothing to resume
        raise


def _map(config: MapConfig) -> None:
    require_known(map_surveys(config), config)


def _refuse_unknown(settings: Mapping[str, Any]) -> None:
    known = [field.name for field in fields(MapConfig) if field.name not in {"surveys", "out"}]
    unknown = [name for name in settings if name not in known]
    if unknown:
        raise TypeError(f"map_survey() has no setting {', '.join(unknown)}; there are: {', '.join(known)}")


def _places(surveys: PathLike | Iterable[PathLike]) -> tuple[Path | str, ...]:
    """Convert one path or several to Path objects; URLs stay strings."""
    several = [surveys] if isinstance(surveys, str | os.PathLike) else surveys
    if not isinstance(several, Iterable):
        raise UsageError(f"surveys is {several!r}; give a path or a list of them")
    texts = [place_text("surveys", survey) for survey in several]
    if not texts:
        raise UsageError("surveys is empty; give a path or a list of them")
    return tuple(text if "://" in text else Path(text) for text in texts)


def place_text(name: str, place: PathLike) -> str:
    """Return a path as text; raise UsageError if it is not a valid path."""
    if not isinstance(place, str | os.PathLike):
        raise UsageError(f"{name} is {place!r}; it must be a path")
    text = os.fspath(place)
    if reason := path_fault(text) or ("" if text else "the path is empty; the current folder is called ."):
        raise UsageError(f"{name}: {reason}")
    return text
