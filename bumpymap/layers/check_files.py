"""How far a map is off the drives over it, by stretch: check.geojson, and the findings in check.json."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from bumpymap.core import CLASS_NAMES, NO_CLASS, NORMAL_80, CheckResult, DrivenStretches, plain_json
from bumpymap.layers.colours import OFF_KINDS
from bumpymap.layers.map_reader import MapReader
from bumpymap.layers.placement import Placement
from bumpymap.layers.vector import GeoJsonCoordinates, feature, plain_numbers, write_features
from bumpytiles import TileWindow

_EDGES = np.array([1 / 2, 1 / 1.5, 1 / 1.2, 1.2, 1.5, 2.0])
"""Ratios of map to drive at which the next of ``OFF_KINDS`` begins."""
NOT_COMPARED = len(OFF_KINDS) - 1


@dataclass(frozen=True, slots=True)
class MapOffset:
    """How far the map is off on some stretches; (n,) each."""

    ratio: NDArray[np.float64]
    """C_r of the map / measured; NaN where one is not known, or nothing was measured above the sensor's floor."""
    kind: NDArray[np.uint8]
    """Code of ``OFF_KINDS``."""
    beyond: NDArray[np.float64]
    """Difference of map and drive over the largest that errors explain; above 1, they do not. NaN as ``ratio``."""

    @classmethod
    def of(cls, driven: DrivenStretches) -> "MapOffset":
        """Compare.

        Errors explain a measurement in the map's 80 % interval, of which each end has been moved outwards, in
        quadrature, by 80 % of the errors of measurement and place: as `MapAgreement.inside` counts.
        """
        known = (driven.measured > 0.0) & (driven.c_r > 0.0)
        measured, c_r = (np.where(known, values, np.nan) for values in (driven.measured, driven.c_r))
        ratio = c_r / measured
        kind = np.where(known, np.digitize(ratio, _EDGES), NOT_COMPARED).astype(np.uint8)
        side = np.where(measured > c_r, driven.c_r_high - c_r, c_r - driven.c_r_low)
        error = NORMAL_80 * np.hypot(np.nan_to_num(driven.measured_sd), np.nan_to_num(driven.place_sd))
        most = np.hypot(np.nan_to_num(side, posinf=np.inf), error)
        with np.errstate(invalid="ignore", divide="ignore"):
            beyond = np.where(most > 0.0, np.abs(measured - c_r) / most, np.inf)
        return cls(ratio, kind, np.where(known, beyond, np.nan))

    @property
    def is_off(self) -> NDArray[np.bool_]:
        """Where errors do not explain the difference."""
        return np.asarray(self.beyond > 1.0, dtype=np.bool_)


def place_stretches(stretches: DrivenStretches, ground: MapReader) -> Placement | None:
    """Return where the stretches of a check lie, for its files; None if no position of one is known."""
    points = np.column_stack([stretches.easting, stretches.northing])
    known = points[np.isfinite(points).all(axis=1)]
    if not len(known):
        return None
    return Placement(ground.georeference, ground.grid, TileWindow.around(*ground.grid.index(known).T))


_DECIMALS = {"way_m": 3, "speed_mps": 3, "start_s": 3, "end_s": 3}
"""Of lengths, speeds and times; all other numbers have 6."""


def write_stretches(result: CheckResult, placement: Placement, path: Path) -> None:
    """Write the stretches whose position is known as GeoJSON: WGS 84, or the survey's own coordinates without a CRS.

    ``placement``: from `place_stretches`. Raises OutputError: the file cannot be written; BadInputError: a position
    cannot be transformed to longitude and latitude.
    """
    properties = stretch_properties(result)
    middles = np.column_stack([result.stretches.easting, result.stretches.northing])
    shown = np.flatnonzero(np.isfinite(middles).all(axis=1))
    place = GeoJsonCoordinates.of(placement, local=True)
    points = shapely.points(place.in_file(middles[shown]))
    features = [
        feature({key: values[at] for key, values in properties.items()}, point, at + 1)
        for at, point in zip(shown.tolist(), points, strict=True)
    ]
    write_features(path, "check", place, features)


def stretch_properties(result: CheckResult) -> dict[str, list[Any]]:
    """Return what files say of each stretch, by name: plain values, None where not known."""
    stretches, offset = result.stretches, MapOffset.of(result.stretches)
    compared = np.isfinite(offset.ratio).tolist()
    names, line = [drive.name for drive in result.drives], result.by_line
    of_line = {} if line is None else _numbers(line, ("c_r", "c_r_low", "c_r_high"))
    return {
        "drive": [names[number] for number in stretches.drive.tolist()],
        **_numbers(stretches, ("start_s", "end_s", "way_m", "speed_mps", "measured", "measured_sd")),
        **_numbers(stretches, ("c_r", "c_r_low", "c_r_high", "place_sd")),
        **{name.replace("c_r", "c_r_line"): values for name, values in of_line.items()},
        "ratio": plain_numbers(offset.ratio, 4),
        "off": [OFF_KINDS[kind] for kind in offset.kind.tolist()],
        "explained": [not off if known else None for off, known in zip(offset.is_off.tolist(), compared, strict=True)],
        **_class("class", stretches.class_id),
        **_class("measured_class", stretches.measured_class),
    }


def _numbers(record: DrivenStretches, names: Sequence[str]) -> dict[str, list[float | None]]:
    return {name: plain_numbers(getattr(record, name), _DECIMALS.get(name, 6)) for name in names}


def _class(name: str, codes: NDArray[np.uint8]) -> dict[str, list[Any]]:
    plain = [None if code == NO_CLASS else code for code in codes.tolist()]
    return {name: plain, f"{name}_name": [None if code is None else CLASS_NAMES[code] for code in plain]}


_OF_MAP = ("c_r", "c_r_low", "c_r_high", "place_sd", "class_id")
"""Columns that hold what the map says of stretches."""


def check_entries(result: CheckResult) -> dict[str, Any]:
    """Return the entries of check.json that hold the findings, as plain JSON: what is not known is null.

    Arrays become lists of numbers, one for each stretch.
    """
    found: dict[str, Any] = {
        "map": result.ground,
        "warnings": result.warnings,
        "skipped": result.skipped,
        "agreement": result.agreement,
        "by_class": [
            {"class": code, "name": CLASS_NAMES[code]} | asdict(agreement)
            for code, agreement in sorted(result.by_class.items())
        ],
        "drives": result.drives,
        "stretches": _columns(result.stretches),
        "line": None,
    }
    if result.by_line is not None:
        columns = _columns(result.by_line)
        found["line"] = {"agreement": result.agreement_by_line, "stretches": {name: columns[name] for name in _OF_MAP}}
    record: dict[str, Any] = plain_json(found)
    return record


def _columns(record: DrivenStretches) -> dict[str, list[Any]]:
    """Return the arrays of a record as lists; no class is None."""
    found = {name: values.tolist() for name, values in asdict(record).items()}
    for name in {"class_id", "measured_class"} & set(found):
        found[name] = [None if code == NO_CLASS else code for code in found[name]]
    return found
