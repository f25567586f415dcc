"""Job: from the layers of two surveys of a site to what has changed between them.

Open both, find which tiles both have, compare heights and ride costs, decide, connect, write.
"""

import math
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from bumpymap.change.compare import (
    NOT_REGISTERED,
    SURE,
    Decision,
    GroundChange,
    Registration,
    cell_pixels,
    common_error,
    decide,
    ground_changes,
    height_offset,
    register,
    ride_change,
)
from bumpymap.core import (
    CHANGE_KINDS,
    CLASS_NAMES,
    NO_CLASS,
    NO_TILE,
    BadInputError,
    Barred,
    DiffConfig,
    Progress,
    SilentProgress,
    brief_repr,
    count_text,
    interval_log_sd,
    path_of_call,
    plain_json,
    settings_of_call,
)
from bumpymap.layers import (
    REPORT_NAME,
    ChangeField,
    MapFile,
    OutputFolder,
    Placement,
    SurveyPair,
    SurveyTiles,
    label,
    open_pair,
    place_entries,
    software_versions,
    write_change_raster,
    write_change_regions,
)
from bumpymap.views import change_layers, least_volume_text, view_writers, write_change_report

CHANGE_FILES = OutputFolder(
    ("change.tif", "change.geojson", "change.json", "change.qml", MapFile.PROJECT, REPORT_NAME),
    "change.json",
    views=("change.qml", MapFile.PROJECT, REPORT_NAME),
)
_DENSITY = 2.0
"""Ratio of the densities from which surveys are unlike: chosen, as the next three."""
_WIDE = 1.5
"""Widening from which the surveys do not fit each other."""
_MOST_CHANGED = 0.3
"""Share of changed tiles from which the rest may be no measure of what has not changed."""
_RIDE = 0.05
"""Median change of the ride cost, as a share, that is reported."""
_LEVEL_M = 0.0005
"""Offset that is shown as 0.000 m."""


def remarks(fit: Mapping[str, Any], counts: Mapping[str, Any]) -> Iterator[str]:
    """Yield remarks and warnings, a sentence each."""
    if fit["offset_m"] is not None:
        taken = fit["offset_taken_off_m"]
        level = abs(fit["offset_m"]) < _LEVEL_M
        side = "higher" if fit["offset_m"] > 0.0 else "lower"
        lies = "level with the earlier one" if level else f"{abs(fit['offset_m']):.3f} m {side}"
        asked = f"; {taken:+.3f} m was taken off, as asked" if taken != fit["offset_m"] else ""
        yield f"the later survey lies {lies} in the median tile{asked or ('' if level else '; taken off')}"
    yield from _of_registration(fit.get("registration"))
    if least := least_volume_text(fit["least_volume_m3"]):
        yield least
    low, high = sorted(fit["median_density_m2"])
    if high > _DENSITY * low:
        yield (
            f"the surveys have unlike densities, {low:,.0f} and {high:,.0f} points per m2: a ride cost depends on it a "
            "little, so changes of the ride count less than those of the ground"
        )
    wide = {name: factor for name, factor in fit["widened"].items() if factor > _WIDE}
    if wide:
        words = ", ".join(f"{name} {factor:.1f} times" for name, factor in wide.items())
        yield (
            f"the surveys differ everywhere by more than their noise ({words}), as if they did not fit each other: "
            "spreads were widened, and small changes are not found. Align them to the same control points"
        )
    ratio = fit["median_ratio_c_r"]
    if ratio is not None and abs(ratio - 1.0) > _RIDE:
        yield f"the ride cost of the median tile is {ratio:.2f} times what it was: the surveys may be what differs"
    if counts["changed"] > _MOST_CHANGED * max(counts["compared"], 1):
        yield (
            f"{counts['changed']:,} of {count_text(counts['compared'], 'tile')} have changed: too many for the rest to "
            "tell offset and noise well"
        )
    left = counts["in_both"] - counts["compared"]
    if left:
        yield f"{count_text(left, 'tile has', 'tiles have')} too few pixels in common to be compared"
    if None not in fit["versions"] and fit["versions"][0] != fit["versions"][1]:
        yield f"the layers were made by versions {' and '.join(fit['versions'])}; map both with one"


def _of_registration(found: Mapping[str, Any] | None) -> Iterator[str]:
    if found is None:
        return
    if found["shift_taken_off"]:
        shift = np.array(found["shift_m"])
        yield (
            f"the later survey lies {np.hypot(*shift):.3f} m off in plan, {shift[0]:+.3f} m east and {shift[1]:+.3f} m "
            "north, by ground that has not changed; taken off. Ride costs are those of the tiles as they were mapped"
        )
    elif found["shift_m"] is None:
        yield "it is unknown whether the surveys are shifted in plan: the ground that both have has too little relief"
    if found["tilt_taken_off"]:
        yield (
            f"the later survey is tilted by {found['tilt_deg']:.4f} degrees, rising towards "
            f"{found['rises_towards_deg']:.0f} degrees from north; taken off"
        )


PathLike: TypeAlias = str | os.PathLike[str]


class DiffSettings(TypedDict, total=False):
    """Settings of `diff_surveys`: fields of ``DiffConfig``."""

    fdr: float
    min_tiles: int
    offset: float | None
    register: bool
    overwrite: bool


@dataclass(frozen=True, slots=True)
class ChangeResult:
    """Result of a comparison."""

    __repr__ = brief_repr

    field: ChangeField
    counts: Mapping[str, Any]
    """Tiles by the kind of their change."""
    transitions: NDArray[np.int64]
    """(5, 5) tiles of each class before (rows) and after (columns), unknown last, of all tiles that both have."""
    fit: Mapping[str, Any]
    """How the surveys fit each other: offset, widening, densities, the size of the cells."""
    files: tuple[Path, ...]
    """Files that were written."""
    notes: tuple[str, ...]
    """Remarks and warnings."""

    @property
    def folder(self) -> Path | None:
        """The folder of the files; None if none were written."""
        return self.files[0].parent if self.files else None


def diff_surveys(
    before: PathLike, after: PathLike, out: PathLike | None = None, **settings: Unpack[DiffSettings]
) -> ChangeResult:
    """Find what has changed between two surveys of a site, as ``bumpymap diff`` does.

    Parameters
    ----------
    before, after : path or Layers
        What `map_survey` or ``bumpymap map`` wrote of the earlier and of the later survey.
    out : path, optional
        Folder for change.tif, change.geojson, change.json, their style and page; without it nothing is written.
    fdr : float
        Share of the changed tiles that may be found by mistake, on average; default 0.05.
    min_tiles : int
        Fewest connected tiles of a change, default 2; smaller ones are left out.
    offset : float, optional
        Height to take off the later survey, m; by default a tilt and the median difference.
    register : bool
        Find and take off a shift in plan and a tilt of the later survey; default True.
    overwrite : bool
        Replace the files of an earlier comparison.

    Returns
    -------
    ChangeResult
        ``counts`` and ``transitions`` (tiles), ``fit``, ``notes``, ``folder``, ``files``.

    Raises
    ------
    BadInputError
        The layers cannot be read, cannot be compared, or have no tile in common.
    UsageError
        A setting is wrong.
    OutputError
        The files cannot be written.

    Examples
    --------
    >>> import bumpymap
    >>> change = bumpymap.diff_surveys("site_layers", "site_layers")
    >>> change.counts["changed"]
    0
    """
    own = settings_of_call(settings, DiffConfig, "diff_surveys", DiffSettings.__annotations__)
    target = None if out is None else Path(path_of_call("out", out))
    return find_changes(
        DiffConfig(Path(path_of_call("before", before)), Path(path_of_call("after", after)), target, **own)
    )


def find_changes(config: DiffConfig, progress: Progress | None = None) -> ChangeResult:
    """Compare two surveys as the settings ask, and write what has changed.

    Raises BadInputError: the layers cannot be read, cannot be compared, or have no tile in common; UsageError,
    OutputError: the files cannot be written.
    """
    progress = progress or SilentProgress()
    pair = open_pair(config.before, config.after)
    if config.out is not None:
        CHANGE_FILES.check(config.out, overwrite=config.overwrite)
    progress.start("comparing", None)
    surveys = pair.tiles(pair.window)
    shared = (surveys[0].barred != NO_TILE) & (surveys[1].barred != NO_TILE)
    if not shared.any():
        raise BadInputError(f"{config.before} and {config.after} have no tile in common. Give two surveys of one site")
    cell = cell_pixels(pair, shared, surveys[0].coverage * surveys[1].coverage)
    with pair.before.kept_open(), pair.after.kept_open():
        found = register(pair, shared, cell) if config.register else NOT_REGISTERED
        if config.offset is not None:  # heights are what is asked for
            found = replace(found, tilt=np.zeros(2))
        offset = height_offset(pair, cell, found)
        taken = offset if config.offset is None else config.offset
        ground = ground_changes(pair, cell, 0.0 if np.isnan(taken) else taken, found)
    # Both have one calibration, or they could not be compared; one may say nothing of its error.
    first, second = (common_error(site.manifest) for site in (pair.before, pair.after))
    before, after = (
        (side.c_r, interval_log_sd(side.c_r, side.c_r_low, side.c_r_high, site.rule.drive_log_sd))
        for side, site in zip(surveys, (pair.before, pair.after), strict=True)
    )
    ride = ride_change(before, after, first if first == second else (0.0, 0.0))
    decision = decide(ground, ride, config.fdr)
    field, dropped = _field(pair, surveys, ground, decision, config.min_tiles)
    fit = _fit(pair, surveys, shared, decision, field) | {
        "offset_m": None if np.isnan(offset) else round(offset, 4),
        "offset_taken_off_m": None if np.isnan(taken) else round(taken, 4),
        "registration": _registration(found) if config.register else None,
        "cell_m": pair.cell_m(cell),
    }
    counts = _counts(field, int(shared.sum())) | {"dropped_as_too_small": dropped}
    classes = (np.minimum(side.class_id[shared], len(CLASS_NAMES)).astype(np.int64) for side in surveys)
    transitions = np.zeros((len(CLASS_NAMES) + 1,) * 2, np.int64)
    np.add.at(transitions, tuple(classes), 1)
    result = ChangeResult(field, counts, transitions, fit, (), tuple(remarks(fit, counts)))
    if config.out is None:
        return result
    progress.start("writing layers", None)
    return replace(result, files=tuple(_write(config, config.out, pair, result)))


def _write(config: DiffConfig, out: Path, pair: SurveyPair, result: ChangeResult) -> list[Path]:
    """Write all files of a comparison, or none; but for change.json and map.qgs, none depends on folder names."""
    field, kept = result.field, ("survey", "inputs", "files")  # what identifies the layers of a run
    sources = {
        name: {"folders": [site.folder], "runs": [{key: site.manifest.get(key) for key in kept}]}
        for name, site in (("before", pair.before), ("after", pair.after))
    }

    def describe(staged: Path, files: list[dict[str, Any]]) -> dict[str, Any]:
        record = {
            "format": "bumpymap-change",
            "version": 1,
            "versions": software_versions(),
            **place_entries(field.placement),
            "settings": asdict(config),
            "sources": sources,
            "vehicle": pair.before.vehicle.name,
            "calibration": pair.before.calibration_id,
            "fit": result.fit,
            "counts": result.counts,
            "classes": {"names": [*CLASS_NAMES, "unknown"], "tiles_before_after": result.transitions},
            "remarks": result.notes,
            "files": files,
        }
        write_change_report(staged, plain_json(record), staged / REPORT_NAME)
        return record

    writers: dict[str, Callable[[Path], None]] = {
        "change.tif": partial(write_change_raster, field),
        "change.geojson": partial(write_change_regions, field),
        **view_writers(change_layers(field), field.placement, pair.after, out, "what has changed"),
    }
    CHANGE_FILES.write(out, writers, describe, overwrite=config.overwrite)
    return [out / name for name in CHANGE_FILES.names]


def _field(
    pair: SurveyPair, surveys: tuple[SurveyTiles, SurveyTiles], ground: GroundChange, decision: Decision, least: int
) -> tuple[ChangeField, int]:
    """Return what change.tif holds, and how many tiles belonged to changes that were too small."""
    before, after = surveys
    sure = np.fmax(np.abs(decision.z_height), decision.z_shape) >= SURE
    code, area, dropped = connect(decision.code, least, sure)
    widened, tile_m2 = decision.widened["height"], pair.before.grid.tile_size**2
    bands = {
        "d_c_r": after.c_r - before.c_r,
        "z_c_r": decision.z_c_r,
        "d_height": ground.d_height,
        "d_largest": ground.d_largest,
        "z_height": decision.z_height,
        "z_shape": decision.z_shape,
        "sd_height": ground.sd_height * widened,
        "least_volume": ground.least_height * widened * tile_m2,
        "changed": code,
    }
    first, last = before.barred == Barred.NO, after.barred == Barred.NO
    values: dict[str, NDArray[Any]] = bands | {"c_r_before": before.c_r, "c_r_after": after.c_r}
    values |= {"class_before": before.class_id, "class_after": after.class_id}
    values |= {"passable_lost": first & ~last, "passable_won": ~first & last}
    place = Placement(pair.before.georeference, pair.before.grid, pair.window)
    stored = {name: array.astype(np.float32) for name, array in bands.items()}
    return ChangeField(place, **stored, area=area, regions=_regions(area, values, tile_m2)), dropped


_SHARES = (0.5, 0.9)
"""Of the compared ground, for which the smallest change that would be found is said."""


def _fit(
    pair: SurveyPair,
    surveys: tuple[SurveyTiles, SurveyTiles],
    shared: NDArray[np.bool_],
    decision: Decision,
    field: ChangeField,
) -> dict[str, Any]:
    before, after = surveys
    least = field.least_volume[~np.isnan(field.least_volume)]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = after.c_r[shared] / before.c_r[shared]
    known = ratio[np.isfinite(ratio)]
    versions = [site.manifest["versions"].get("bumpymap") for site in (pair.before, pair.after)]
    return {
        "widened": {name: round(factor, 3) for name, factor in decision.widened.items()},
        "least_volume_m3": [_number(volume) for volume in np.quantile(least, _SHARES, method="higher")]
        if len(least)
        else None,
        "median_ratio_c_r": round(float(np.median(known)), 4) if len(known) else None,
        "median_density_m2": [round(float(np.nanmedian(side.density[shared])), 2) for side in surveys],
        "versions": versions,
    }


def _registration(found: Registration) -> dict[str, Any]:
    """Return what `register` found and took off, as it stands in change.json."""
    east, north = found.found_tilt
    rise = math.hypot(east, north)
    return {
        "shift_m": None if np.isnan(found.found_shift_m).any() else found.found_shift_m.round(4).tolist(),
        "shift_sd_m": None if np.isnan(found.shift_sd_m).any() else found.shift_sd_m.round(4).tolist(),
        "shift_taken_off": bool(found.shift_m.any()),
        "tilt_deg": None if np.isnan(rise) else round(math.degrees(math.atan(rise)), 4),
        "tilt_sd_deg": None if np.isnan(rise) else round(math.degrees(math.atan(found.tilt_sd)), 6),
        "rises_towards_deg": None if np.isnan(rise) else round(math.degrees(math.atan2(east, north)) % 360.0, 1),
        "tilt_taken_off": bool(found.tilt.any()),
        "stable_tiles": found.stable,
    }


def _counts(field: ChangeField, in_both: int) -> dict[str, Any]:
    moved = np.nan_to_num(field.changed) > 0.0
    return {
        "in_both": in_both,
        "compared": int(np.isfinite(field.changed).sum()),
        "changed": int(moved.sum()),
        "by_change": {text: int((field.changed == kind).sum()) for kind, text in enumerate(CHANGE_KINDS)},
        "regions": len(field.regions),
        **{name: sum(about[name] for about in field.regions) for name in ("passable_lost", "passable_won")},
        "volumes": _volumes(field.d_height[moved], field.sd_height[moved], field.placement.grid.tile_size**2),
    }


def _volumes(d_height: NDArray[np.floating], sd_height: NDArray[np.floating], area_m2: float) -> dict[str, float]:
    """Return the m3 that were heaped up and dug on changed tiles, (n,), with standard deviations."""
    variance, found = np.nan_to_num(sd_height.astype(np.float64)) ** 2, {}
    for name, chosen in (("heaped", d_height > 0.0), ("dug", d_height < 0.0)):
        found[f"{name}_m3"] = round(area_m2 * float(np.abs(d_height[chosen].astype(np.float64)).sum()), 2)
        found[f"{name}_sd_m3"] = round(area_m2 * math.sqrt(float(variance[chosen].sum())), 2)
    return found


def connect(
    code: NDArray[np.float64], least: int, sure: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.int32], int]:
    """Find connected changes, of tiles that share a side; drop those of fewer than ``least`` tiles, none of them sure.

    ``code`` (rows, cols): a position in ``CHANGE_KINDS``; NaN where not compared; ``sure`` (rows, cols). Returns it
    with 0 where a change was dropped; the number of the change of each tile, (rows, cols), from 1 in the order of first
    tiles, 0: none; and the number of tiles that were dropped.
    """
    found = np.nan_to_num(code) > 0.0
    labels, first = label(found.astype(np.uint8))
    size = np.bincount(labels.ravel(), minlength=len(first) + 1)
    kept = size >= least
    kept[labels[sure & found]] = True
    kept[0] = False
    number = np.where(kept, np.cumsum(kept), 0).astype(np.int32)
    area = number[labels]
    small = found & (area == 0)
    return np.where(small, 0.0, code), area, int(small.sum())


def _regions(area: NDArray[np.int32], values: Mapping[str, NDArray[Any]], tile_m2: float) -> tuple[dict[str, Any], ...]:
    """Return the properties of each connected change, as they stand in change.geojson.

    ``area`` (rows, cols): from `connect`; ``values``: what `_describe` takes, (rows, cols) each.
    """
    place = np.flatnonzero(area)
    order = place[np.argsort(area.ravel()[place], kind="stable")]
    parts = np.split(order, np.flatnonzero(np.diff(area.ravel()[order])) + 1) if len(order) else []
    flat = {name: array.ravel() for name, array in values.items()}
    return tuple(_describe({name: array[tiles] for name, array in flat.items()}, tile_m2) for tiles in parts)


def _describe(tiles: Mapping[str, NDArray[Any]], area_m2: float) -> dict[str, Any]:
    """Return the properties of one change from the values of its tiles, (n,) each."""
    heights, kinds = tiles["d_height"], tiles["changed"]
    # The class of most tiles, the lower of two.
    classes = {name: int(np.argmax(np.bincount(tiles[name]))) for name in ("class_before", "class_after")}
    return {
        "tiles": len(kinds),
        "area_m2": round(len(kinds) * area_m2, 3),
        "kind": CHANGE_KINDS[max(_FIRST, key=lambda kind: int((kinds == kind).sum()))],
        **{
            CHANGE_KINDS[kind].replace(",", "").replace(" ", "_"): int((kinds == kind).sum()) for kind in sorted(_FIRST)
        },
        "d_height": _number(heights.mean()),
        "d_height_lowest": _number(heights.min()),
        "d_height_highest": _number(heights.max()),
        "d_largest": _of_known(_farthest, tiles["d_largest"]),
        "volume_m3": _number(heights.sum() * area_m2),
        "volume_sd_m3": _number(area_m2 * math.sqrt(np.nansum(tiles["sd_height"] ** 2))),
        **{name: _of_known(np.mean, tiles[name]) for name in ("d_c_r", "c_r_before", "c_r_after")},
        **{name: _of_known(_farthest, tiles[name]) for name in ("z_height", "z_shape", "z_c_r")},
        **{name: None if commonest == NO_CLASS else commonest for name, commonest in classes.items()},
        **{name: int(tiles[name].sum()) for name in ("passable_lost", "passable_won")},
    }


_FIRST = (2, 4, 5, 3, 1)
"""Positions in ``CHANGE_KINDS`` in the order in which they stand for a place where several have most tiles."""


def _number(value: float) -> float | None:
    return round(float(value), 4) if np.isfinite(value) else None


def _of_known(summary: Callable[[Any], Any], values: NDArray[np.floating]) -> float | None:
    known = values[np.isfinite(values)]
    return _number(summary(known)) if len(known) else None


def _farthest(values: NDArray[np.floating]) -> Any:
    """Return the value farthest from 0."""
    return values[np.argmax(np.abs(values))]
