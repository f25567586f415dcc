"""Drive along the chosen ways."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Steps
from bumpymap.lab.evaluate.keyed_random import uniform_by_key
from bumpymap.lab.evaluate.routes.measured import driven_heights
from bumpymap.lab.evaluate.routes.pairs import WayPair
from bumpymap.lab.evaluate.routes.settings import RouteTrialSettings
from bumpymap.lab.evaluate.trial import TrialOptions
from bumpymap.lab.simulate import DriveSettings, JobJournal, Key, ReliefGround, WayDrive, drive_jobs, drive_way
from bumpymap.rating import Vehicle
from bumpytiles import TileWindow

if TYPE_CHECKING:
    from bumpymap.layers import RouteMap

__all__ = ["WAYS", "WayJob", "drive_pairs", "run_way"]

WAYS = ("best", "straight")
_ROOM_TILES = 2
"""Tiles around a way whose heights are read."""


@dataclass(frozen=True, slots=True)
class WayJob:
    """One drive along one way."""

    key: Key
    line: NDArray[np.float64]
    """(n, 2) field coordinates."""
    offset: float
    """m to the left."""
    starts: int = 1


@dataclass(frozen=True)
class DrivenMap:
    """What all drives share."""

    route_map: "RouteMap"
    profile: Vehicle
    drive: DriveSettings


def drive_pairs(
    route_map: "RouteMap",
    profile: Vehicle,
    pairs: Sequence[WayPair],
    settings: RouteTrialSettings,
    options: TrialOptions,
) -> dict[Key, WayDrive]:
    """Drive along both ways of every pair, ``repeats`` times each.

    Parameters
    ----------
    route_map : RouteMap
        The map, for its heights and obstacles.
    profile : Vehicle
    pairs : sequence of WayPair
        In field coordinates of the window of the map.
    settings : RouteTrialSettings
    options : TrialOptions

    Returns
    -------
    dict
        (number of the pair, ``best`` or ``straight``, number of the drive) -> drive.
    """
    jobs = [
        WayJob((number, name, repeat), line, _offset(settings, number, repeat))
        for number, pair in enumerate(pairs)
        for name, line in pair.lines().items()
        for repeat in range(settings.repeats)
    ]
    options.progress.start(f"driving {profile.name} along ways", len(jobs))
    return drive_jobs(
        partial(run_way, DrivenMap(route_map, profile, settings.drive)),
        jobs,
        Steps(options.progress),
        workers=options.workers,
        journal=JobJournal(
            options.out / f"ways-{profile.name}.jsonl",
            _recorded(route_map, profile, pairs, settings),
            WayDrive.from_record,
        ),
        discard_other=options.overwrite,
    )


def run_way(driven: DrivenMap, job: WayJob) -> WayDrive:
    """Read the heights around a way and drive along it; ``tiles`` of the result are columns and rows of the map."""
    route_map, grid = driven.route_map, driven.route_map.grid
    whole = route_map.window
    low, high = job.line.min(axis=0) - _ROOM_TILES, job.line.max(axis=0) + _ROOM_TILES
    (top, left), (bottom, right) = np.floor(low).astype(int).tolist(), np.ceil(high).astype(int).tolist()
    window = TileWindow(whole.col + left, whole.row + whole.rows - bottom, right - left, bottom - top)
    heights = driven_heights(route_map.heights(window), route_map.objects(window))
    ground = ReliefGround.from_heightmap(heights, grid.pixel_size)
    corners = np.stack([job.line[:, 1] - left, bottom - job.line[:, 0]], axis=1) * grid.tile_size
    made = drive_way(driven.profile, ground, corners, grid.tile_size, job.offset, driven.drive)
    # From tiles of the small window, counted from the south, to those of the map's arrays.
    made.tiles = [(col + left, bottom - 1 - row, path, pitch) for col, row, path, pitch in made.tiles]
    return made


def _offset(settings: RouteTrialSettings, number: int, repeat: int) -> float:
    share = uniform_by_key(settings.seed, np.array([number]), np.array([repeat]))[0]
    return float(settings.offset_m * (2 * share - 1))


def _recorded(
    route_map: "RouteMap", profile: Vehicle, pairs: Sequence[WayPair], settings: RouteTrialSettings
) -> dict[str, Any]:
    """Return everything that affects the drives, as JSON."""
    files = [
        {
            file["path"]: file["sha256"]
            for file in manifest["files"]
            if file["path"] in ("heightmap.tif", "obstacle.tif")
        }
        for manifest in route_map.manifests
    ]
    return {
        "vehicle": profile.to_dict(),
        "files": files,
        "lines": [{name: line.round(9).tolist() for name, line in pair.lines().items()} for pair in pairs],
        "seed": settings.seed,
        "repeats": settings.repeats,
        "offset_m": settings.offset_m,
        "drive": asdict(settings.drive),
        "versions": {name: version(name) for name in ("dartpy", "numpy")},
    }
