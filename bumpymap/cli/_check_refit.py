"""``bumpymap check --refit``: move the calibration of a map to the drives over it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bumpymap.cli._text import print_line
from bumpymap.core import (
    BadInputError,
    DrivenStretches,
    OutputError,
    UsageError,
    atomic,
    locked,
    parse_json,
    read_regular,
)

if TYPE_CHECKING:
    from bumpymap.layers import RouteMap
    from bumpymap.rating import Calibration, DriveUpdate

__all__ = ["Refit", "prepare_refit"]

_LEAST_WIDENING = 1.05


@dataclass(frozen=True, slots=True)
class Refit:
    """A calibration to move, and the file to write."""

    calibration: "Calibration"
    out: Path
    overwrite: bool

    def move(self, stretches: DrivenStretches, speed_mps: float) -> "DriveUpdate":
        """Move the calibration to drives over a map at a speed, and write it.

        Raises
        ------
        BadInputError
            The drives are too short, or agree with the calibration.
        OutputError
            The file cannot be written.
        """
        from bumpymap.rating import UpdateSettings, update_from_drives

        moved, update = update_from_drives(self.calibration, stretches, UpdateSettings(speed_mps=speed_mps))
        _make_folder(self.out)
        with locked(self.out.parent, f".{self.out.name}.lock"):
            _refuse_replacing(self.out, self.overwrite)
            with atomic(self.out) as beside:
                beside.write_text(moved.to_json(), encoding="utf-8")
        return update

    def show(self, update: "DriveUpdate") -> None:
        """Print what was found, in words."""
        for line in _words(update):
            print_line(line)
        print_line(f"Calibration: {self.out}. Map with it: bumpymap map SURVEY --out DIR --calibration {self.out}")

    def record(self, update: "DriveUpdate") -> dict[str, Any]:
        """Return what was found, as plain JSON."""
        return {"out": str(self.out), **update.to_record()}


def prepare_refit(layers: Path | None, calibration: Path | None, out: Path, *, overwrite: bool) -> Refit:
    """Find the calibration of a map before the drives are measured.

    Parameters
    ----------
    layers : Path or None
        Folder of the map.
    calibration : Path, optional
        Its calibration file; None: the one that its run.json names.
    out : Path
        The calibration file to write.
    overwrite : bool
        Replace that file.

    Raises
    ------
    UsageError
        There is no map, or its calibration is not found.
    BadInputError
        The layers or the calibration cannot be read, or do not belong together.
    OutputError
        The file exists.
    """
    from bumpymap.layers import open_map

    if layers is None:
        raise UsageError("`refit` moves the calibration of a map to drives over it: give the folder of the map")
    _refuse_replacing(out, overwrite)
    return Refit(_calibration_of(open_map([layers]), calibration), out, overwrite)


def _make_folder(out: Path) -> None:
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write {out}: {error}; choose a file in a folder that you may write") from error


def _require_own_speed(calibration: "Calibration", site: "RouteMap") -> None:
    """Refuse a map at another speed: what moves is the C_r of the calibration's own drives."""
    own, speed = float(calibration.vehicle["speed_mps"]), site.vehicle.speed_mps
    if not math.isclose(own, speed):
        raise BadInputError(
            f"the map is made for {speed:g} m/s, and the calibration {calibration.id} rests on drives at {own:g} m/s, "
            f"which is what a refit moves. Drive at {own:g} m/s over a map at that speed, or calibrate a profile "
            f"whose speed is {speed:g} m/s"
        )


def _refuse_replacing(out: Path, overwrite: bool) -> None:
    above = next(folder for folder in out.absolute().parents if folder.exists())
    if not above.is_dir():
        raise OutputError(f"cannot write {out}: {above} is a file; choose a file in a folder that you may write")
    if out.is_dir():
        raise OutputError(f"{out} is a folder; `refit` takes the file to write, such as `refit='my_robot.json'`")
    if (out.exists() or out.is_symlink()) and not overwrite:
        raise OutputError(f"{out} exists; give `overwrite=True` to replace it, or another file with `refit`")
    if out.is_file() and not out.is_symlink() and not _is_calibration(out):
        raise OutputError(f"{out} is no calibration, and was not touched; choose another file with `refit`")


def _is_calibration(path: Path) -> bool:
    """Return whether a file is one, of any version: no other file is replaced by one."""
    try:
        found = parse_json(read_regular(path).decode())
    except (OSError, ValueError):
        return False
    return isinstance(found, dict) and found.get("format") == "bumpymap-calibration"


def _calibration_of(site: "RouteMap", given: Path | None) -> "Calibration":
    """Return the calibration that a map was made with."""
    from bumpymap.rating import find_calibration

    settings = site.manifests[0].get("settings", {})
    named = given or settings.get("calibration")
    try:
        vehicle = settings.get("vehicle") or site.vehicle.name
        found = find_calibration(str(vehicle), Path(named) if named else None)
    except (BadInputError, UsageError) as error:
        if given:
            raise
        raise UsageError(
            f"the calibration {site.calibration_id} of the map is not found ({error}). Give its file with `calibration`"
        ) from error
    if found.id != site.calibration_id:
        if found.vehicle["name"] == site.vehicle.name:
            _require_own_speed(found, site)
        raise BadInputError(
            f"the map was made with the calibration {site.calibration_id} of {site.vehicle.name}; "
            f"{named or vehicle} holds {found.id}. Give the file of the map's own with `calibration`, or map the "
            "survey again"
        )
    return found


def _words(update: "DriveUpdate") -> Iterator[str]:
    low, middle, high = (factor - 1.0 for factor in update.factor)
    more = "more" if middle >= 0 else "less"
    ends = sorted((abs(low), abs(high))) if low * high > 0 else (low, high)
    several = f" of {update.drives} drives" if update.drives > 1 else ""
    yield (
        f"{update.way_m:.0f} m of driving on {update.stretches} stretches{several}, {update.new_m:.0f} m of it on "
        f"different ground: this vehicle pitches {_percent(abs(middle))} {more} than the calibration says (80 % "
        f"interval: {_percent(ends[0])} to {_percent(ends[1])})"
    )
    yield (
        f"C_r / measured, median: {update.ratio[0]:.2f} before, {update.ratio[1]:.2f} with the new calibration; on "
        f"parts of the drives left out in turn, the median error goes from {_percent(update.held_out_error[0])} to "
        f"{_percent(update.held_out_error[1])}"
    )
    if update.posterior.map_scale > _LEAST_WIDENING:
        yield (
            f"Over the same ground the drives are off the map {update.posterior.map_scale:.1f} times as far as its "
            "intervals say; those of the new calibration are wider by that"
        )


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"
