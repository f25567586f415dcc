"""Drives that a map was checked against, for its page."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import BadInputError, CheckResult
from bumpymap.layers.check.offset import MapOffset
from bumpymap.layers.check.record import read_check
from bumpymap.layers.check.words import percent
from bumpymap.layers.manifest import MANIFEST_NAME, describe_file

__all__ = ["DrawnCheck", "read_drawn_check"]

_REMEDY = "Check this map, with `bumpymap check`, and give the folder as `check`"


@dataclass(frozen=True, slots=True)
class DrawnCheck:
    """What drives show of the map of a page."""

    result: CheckResult
    is_of_this_run: bool
    """False where the layers were written again since."""

    def places(self) -> list[dict[str, Any]]:
        """Return each stretch with a position as the script of the page needs it."""
        stretches, offset = self.result.stretches, MapOffset.of(self.result.stretches)
        known = np.isfinite(stretches.easting) & np.isfinite(stretches.northing)
        return [
            {
                "east": round(float(stretches.easting[at]), 2),
                "north": round(float(stretches.northing[at]), 2),
                "kind": int(offset.kind[at]),
                "off": bool(offset.is_off[at]),
                "text": self._text(at, float(offset.ratio[at])),
            }
            for at in np.flatnonzero(known).tolist()
        ]

    def _text(self, at: int, ratio: float) -> str:
        stretches = self.result.stretches
        name = self.result.drives[int(stretches.drive[at])].name
        text = f"{name} measured {stretches.measured[at]:.3f} rad/m"
        if not np.isfinite(ratio):
            return text
        level = f"{percent(abs(ratio - 1.0))} {'high' if ratio > 1.0 else 'low'}"
        return f"{text}, the map says {stretches.c_r[at]:.3f} along the stretch ({level})"


def read_drawn_check(check: Path, record: Mapping[str, Any], layers: Path) -> DrawnCheck:
    """Read the drives in a folder, or in check.json itself, for the page of a map.

    Parameters
    ----------
    check : Path
        What `bumpymap check` wrote.
    record : mapping
        The content of run.json of the map.
    layers : Path
        The folder of the map.

    Raises
    ------
    BadInputError
        There is no check.json, or it is that of another map, or of drives without a map.
    """
    result, found = read_check(check)
    if result.ground is None:
        raise BadInputError(f"the drives in {check} were measured without a map. {_REMEDY}")
    try:
        differences = _differences(result, found, record)
        runs = {str(entry["run_sha256"]) for entry in found.get("layers") or []}
    except (KeyError, TypeError, AttributeError) as error:
        raise BadInputError(f"cannot read {check} as a check: {error!r}. {_REMEDY}") from error
    if differences:
        raise BadInputError(f"{check} is the check of another map than {layers}: {'; '.join(differences)}. {_REMEDY}")
    is_same = bool(record.get("sheets")) or describe_file(layers / MANIFEST_NAME)["sha256"] in runs
    return DrawnCheck(result, is_same)


def _differences(result: CheckResult, found: Mapping[str, Any], record: Mapping[str, Any]) -> list[str]:
    calibration = record.get("calibration")
    own = calibration.get("id") if isinstance(calibration, Mapping) else calibration
    pairs: list[tuple[str, Any, Any]] = [("the calibration", result.ground and result.ground.calibration_id, own)]
    if "grid" in found:  # positions are known
        pairs.append(("the CRS", _crs(found), _crs(record)))
        pairs.append(("the size of tiles", found["grid"]["tile_size_m"], record["grid"]["tile_size_m"]))
    return [f"{what} is {there or 'none'} there, {here or 'none'} here" for what, there, here in pairs if there != here]


def _crs(record: Mapping[str, Any]) -> Any:
    crs = record.get("crs")
    return None if crs is None else crs.get("code") or crs["wkt"]
