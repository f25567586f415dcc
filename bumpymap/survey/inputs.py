"""The input files of a run: opening them, skipping bad ones, refusing what cannot be mapped."""

import logging
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np

from bumpymap.core import BadInputError, Georeference, MapConfig, Orthophoto, common_georeference, memory_bytes
from bumpymap.layers import check_extent, open_photo
from bumpymap.readers import ReadOptions, SurveyInfo, SurveyReader, find_surveys, open_survey, rasters_beside
from bumpytiles import Grid, TileWindow

_log = logging.getLogger(__name__)

_NAMED = 5
"""Number of files that a message names."""


def read_options(config: MapConfig, *, crs_must_agree: bool = False) -> ReadOptions:
    """Return the settings that the readers need."""
    return ReadOptions(
        config.crs,
        config.force_crs,
        crs_must_agree,
        config.xy_unit,
        config.z_unit,
        config.trust_points,
        memory_bytes(config.memory),
        lines=config.align != "off",
        ground_classes=config.ground_classes,
        colour=config.photo is None,
        dtm=config.dtm,
        pixel_m=config.grid.pixel_size,
    )


@dataclass(frozen=True, slots=True)
class SurveyInputs:
    """Open readers of one CRS, and the inputs that were skipped."""

    readers: list[SurveyReader]
    georeference: Georeference
    """Shared by all readers."""
    skip_bad: bool
    """True: a bad input is skipped instead of ending the run."""
    skipped: dict[str, str]
    """Path -> error message; grows while points are read."""
    photo: Orthophoto | None = None

    @classmethod
    def open(cls, config: MapConfig, *, crs_must_agree: bool = True) -> "SurveyInputs":
        """Open every input and check that they share a CRS, before the long work begins.

        ``crs_must_agree``: whether an input that states another CRS than ``config.crs`` is refused; else its own is
        used. Raises BadInputError: an input cannot be read and may not be skipped, none can be read, or they have no
        common CRS; UsageError: an input states another CRS than it must.
        """
        readers: list[SurveyReader] = []
        skipped: dict[str, str] = {}
        for path in find_surveys(config.surveys):
            try:
                readers.append(open_survey(path, read_options(config, crs_must_agree=crs_must_agree)))
            except BadInputError as error:
                _skip(path, error, skipped, skip_bad=config.skip_bad)
        photo = config.photo and config.photo.resolve()
        if rasters := [path for path in rasters_beside(config.surveys) if path.resolve() != photo]:
            _log.warning(
                "not mapped, since the folder holds point clouds: %s. Give a DSM by its own path, an orthophoto as "
                "`photo='FILE'`",
                _named(rasters),
            )
        if not readers:
            raise BadInputError("none of the inputs could be read:", *skipped.values())
        infos = [reader.info for reader in readers]
        georeference = common_georeference(infos)
        for doubt in file_doubts(infos):
            _log.warning("%s", doubt)
        if georeference.crs is not None and config.local:
            _log.warning("`local=True` is not needed: the survey has a CRS (%s)", georeference.crs.name)
        if georeference.crs is None and not config.local:
            raise BadInputError(
                f"{readers[0].info.path} has no CRS, so its location on Earth is unknown. Pass `crs='EPSG:CODE'`, "
                "or `local=True` to map it in its own coordinates (rasters without a CRS, cost.geojson in local metres)"
            )
        if any(info.georeference.assumed for info in infos):
            _log.warning(
                "no CRS states a unit: metres are assumed; if they are feet, pass `xy_unit='ft'` or `xy_unit='us-ft'`"
            )
        areas = [info.bounds for info in infos]
        orthophoto = None if config.photo is None else open_photo(config.photo, georeference, areas)
        return cls(readers, georeference, config.skip_bad, skipped, orthophoto)

    @property
    def paths(self) -> list[Path]:
        """All inputs: the opened ones, then those that were skipped."""
        return [*(reader.info.path for reader in self.readers), *map(Path, self.skipped)]

    def skip(self, reader: SurveyReader, error: BadInputError) -> None:
        """Skip a file that turned out to be bad while it was read; raise ``error`` if bad inputs end the run."""
        _skip(reader.info.path, error, self.skipped, skip_bad=self.skip_bad)

    def check_window(self, grid: Grid, window: TileWindow) -> None:
        """Raise BadInputError, naming the files, if their tiles span more than a raster may."""
        try:
            check_extent(grid, window)
        except BadInputError as error:
            paths = [reader.info.path for reader in self.readers if str(reader.info.path) not in self.skipped]
            raise BadInputError(f"{error}. The files read are: {_named(paths)}") from error


def _named(paths: Sequence[Path]) -> str:
    more = [f"{len(paths) - _NAMED} more"] if len(paths) > _NAMED else []
    return ", ".join([*map(str, paths[:_NAMED]), *more])


_FAR = 100_000.0
"""Length, m, that no survey has, and distance that no two files of one have."""
_BESIDE_M, _GAP_M, _LIKE = 10.0, 5.0, 0.05
"""Files that are at most this far apart, m, lie side by side. Then the gap between their heights, m, is at most the
second; if it is more and the ratio of the heights is this near to that of feet and metres, they may be these."""


def file_doubts(infos: Sequence[SurveyInfo]) -> list[str]:
    """Return what the headers of files say that cannot be true of one survey: stray places, other units of height."""
    known = [(info, astuple(info.bounds)) for info in infos if info.bounds is not None]
    west, south, east, north = np.array([box for _, box in known]).reshape(-1, 4).T
    low, high = np.array([info.heights or (np.nan, np.nan) for info, _ in known]).reshape(-1, 2).T
    doubts, gaps = [], []
    for at, (info, _) in enumerate(known):
        aside = np.maximum(np.maximum(west - east[at], west[at] - east), 0.0)
        apart = np.hypot(aside, np.maximum(np.maximum(south - north[at], south[at] - north), 0.0))
        apart[at] = np.inf
        side, nearest = max(east[at] - west[at], north[at] - south[at]), apart.min()
        at_origin = min(abs(west[at]), abs(east[at])) + min(abs(south[at]), abs(north[at])) < 1.0
        if side > _FAR:
            remove = "remove them, such as with: pdal translate IN OUT.laz range --filters.range.limits='X[1:],Y[1:]'"
            reason = f"some lie at the origin (0, 0); {remove}" if at_origin else "there may be stray coordinates"
            doubts.append(f"the points of {info.path} are spread over {side / 1000:,.0f} km: {reason}")
        elif _FAR < nearest < np.inf:
            place = ", at the origin (0, 0)" if at_origin else ""
            doubts.append(f"{info.path} lies {nearest / 1000:,.0f} km from all other files{place}: leave it out?")
        gaps += [(at, other) for other in np.flatnonzero((apart <= _BESIDE_M) & (low[at] - high > _GAP_M)).tolist()]
    for at, other in gaps[:_NAMED]:
        own, beside = low[at] + high[at], low[other] + high[other]
        in_feet = abs(0.3048 * own - beside) < _LIKE * abs(beside)
        why = "in feet, which `z_unit` sets?" if in_feet else "of another datum, such as ellipsoid and geoid?"
        doubts.append(
            f"the heights of {known[at][0].path}, from {low[at]:,.1f} m, lie {low[at] - high[other]:,.1f} m above "
            f"those of {known[other][0].path} beside it, up to {high[other]:,.1f} m: is one of them {why} Bring both "
            "to one before they are mapped together"
        )
    if len(gaps) > _NAMED:
        doubts.append(f"so do those of {len(gaps) - _NAMED} more pairs of files")
    return doubts


def _skip(path: Path, error: BadInputError, skipped: dict[str, str], *, skip_bad: bool) -> None:
    if not skip_bad:
        raise error
    _log.warning("skipped %s: %s", path, error)
    skipped[str(path)] = str(error)
