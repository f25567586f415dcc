"""Drives of known truth for `drive_check.py`: ways over a map, driven in DART once and kept."""

import json
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from bumpymap.core import Barred, TileField
from bumpymap.layers import MapReader, open_map
from bumpymap.rating import Vehicle
from bumpymap.route import CostSettings
from bumpymap.route.ground import CostGround
from bumpymap.route.places import on_grid, place_in_window
from bumpymap.route.planner import Planner
from bumpytiles import TileWindow

sys.path.append(str(Path(__file__).resolve().parents[1] / "worlds"))

from driven_ways import RecordSettings, ReliefGround, Stop, record_way
from sensed_drives import TrueDrive, read_motion, save_motion

_ROOM_TILES = 3
_STOP_S = 3.0
_SMOOTH_SEED, _ROUGH_SEED = 11, 23
_LEAST_M, _MOST_M, _MOST_TRIED = 60.0, 150.0, 5000


GroundAlong = Callable[[NDArray[np.float64]], tuple[ReliefGround, NDArray[np.float64]]]
"""Line (n, 2), easting and northing [m] -> the ground around it, and its south-west corner (2,), m."""


@dataclass(frozen=True)
class KeptDrive:
    """A drive and the map that it was driven over."""

    name: str
    folder: Path
    layers: Path

    @property
    def motion(self) -> TrueDrive:
        """The motion; easting and northing are those of the map."""
        return read_motion(self.folder / f"{self.name}.npz")

    @cached_property
    def facts(self) -> dict[str, object]:
        """Vehicle, outcome and C_r of the whole way."""
        return json.loads((self.folder / f"{self.name}.json").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class WayTask:
    """One drive to make."""

    name: str
    line: NDArray[np.float64]
    """(n, 2) easting and northing, m."""
    vehicle: Vehicle


def stiff(profile: Vehicle, factor: float, damping: float = 1.0) -> Vehicle:
    """Return the vehicle with a stiffer suspension than its profile says."""
    rocker = replace(
        profile.rocker,
        stiffness_nm_per_rad=profile.rocker.stiffness_nm_per_rad * factor,
        damping_nms_per_rad=profile.rocker.damping_nms_per_rad * damping,
    )
    return replace(profile, rocker=rocker)


def kept_ways(path: Path, layers: Path, count: int, weights: tuple[float, float]) -> list[NDArray[np.float64]]:
    """Return planned ways, from a file if they were planned before."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, *_planned_ways(layers, count, weights))
    with np.load(path) as held:
        return [held[name] for name in held.files]


def _planned_ways(layers: Path, count: int, weights: tuple[float, float]) -> list[NDArray[np.float64]]:
    """Plan ways of 60 to 150 m between random places of a map; corners (n, 2) in its easting and northing, m.

    ``weights`` are those of ride and failure. With those of the vehicle the ways keep to smooth ground; with small ones
    they are short and rough.
    """
    opened = open_map([layers])
    ride, fail = weights
    rule = replace(opened.rule, ride_weight=ride, fail_weight=fail)
    site = replace(opened, sheets=tuple(replace(sheet, rule=rule) for sheet in opened.sheets))
    planner = Planner(CostGround(site, CostSettings(), site.window.cols * site.window.rows))
    lines = []
    for ends in _ends(site.read(site.window), _SMOOTH_SEED if ride else _ROUGH_SEED):
        if (line := planner.line(*on_grid(np.asarray(ends, np.float64), site.grid, site.window))) is None:
            continue
        corners = np.array([place_in_window(corner, site.grid, site.window) for corner in line])
        corners[[0, -1]] = ends
        east, south = site.window.col + corners[:, 1], site.window.row + site.window.rows - corners[:, 0]
        lines.append(np.stack([east, south], axis=1) * site.grid.tile_size)
        if len(lines) == count:
            break
    return lines


def _ends(field: TileField, seed: int) -> Iterator[NDArray[np.float64]]:
    """Yield centres of two joined passable tiles (2, 2), in tiles from north and west, with known C_r between them."""
    with np.errstate(invalid="ignore"):
        cost = field.rule.cost(field.c_r.astype(np.float64), field.rule.hazard(field.p_fail))
    passable = (field.barred == Barred.NO) & np.isfinite(cost)
    part, tiles, rng = label(passable)[0], np.argwhere(passable), np.random.default_rng(seed)
    for _ in range(_MOST_TRIED if len(tiles) else 0):
        ends = tiles[rng.integers(len(tiles), size=2)]
        metres = float(np.hypot(*(ends[1] - ends[0]))) * field.grid.tile_size
        if _LEAST_M <= metres <= _MOST_M and part[tuple(ends[0])] == part[tuple(ends[1])]:
            row, col = _tiles_between(*(ends + 0.5))
            if np.isfinite(field.c_r[row, col]).all():
                yield ends + 0.5


def _tiles_between(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the row and column (2, n) of the tiles that a line from ``a`` to ``b`` crosses."""
    cuts = [np.array([0.0, 1.0])]
    for start, end in zip(a.tolist(), b.tolist(), strict=True):
        if start != end:
            borders = np.arange(math.floor(min(start, end)) + 1, math.ceil(max(start, end)))
            cuts.append((borders - start) / (end - start))
    at = np.unique(np.concatenate(cuts))
    return np.floor(a + (b - a) * ((at[1:] + at[:-1]) / 2)[:, None]).astype(np.int64).T


def heights_of(layers: Path) -> GroundAlong:
    """Return the heights of a map as ground."""
    return partial(_heights_along, open_map([layers]))


def _heights_along(site: MapReader, line: NDArray[np.float64]) -> tuple[ReliefGround, NDArray[np.float64]]:
    size = site.grid.tile_size
    low = np.floor(line.min(axis=0) / size).astype(int) - _ROOM_TILES
    high = np.ceil(line.max(axis=0) / size).astype(int) + _ROOM_TILES
    window = TileWindow(*low.tolist(), *(high - low).tolist())
    return ReliefGround.from_heightmap(site.heights(window), site.grid.pixel_size, site.objects(window)), low * size


def make_drives(tasks: list[WayTask], ground: GroundAlong, layers: Path, folder: Path) -> Iterator[KeptDrive]:
    """Drive all ways that are not yet in the folder, and yield all that were driven to their end."""
    folder.mkdir(parents=True, exist_ok=True)
    for task in tasks:
        kept = KeptDrive(task.name, folder, layers)
        if not (folder / f"{task.name}.json").exists():
            begin = time.process_time()
            _make(task, ground, kept)
            said = [str(kept.facts[name]) for name in ("outcome", "path_m", "c_r")]
            sys.stdout.write(f"{task.name}: {' '.join(said)}, {time.process_time() - begin:.0f} s\n")
            sys.stdout.flush()
        if kept.facts["outcome"] == "completed":
            yield kept


def _make(task: WayTask, ground_along: GroundAlong, kept: KeptDrive) -> None:
    ground, corner = ground_along(task.line)
    length = math.fsum(math.dist(a, b) for a, b in pairwise(task.line.tolist()))
    stops = tuple(Stop(share * length, _STOP_S) for share in (0.3, 0.65))
    made = record_way(task.vehicle, ground, task.line - corner, RecordSettings(stops=stops))
    shift = np.array([*corner, 0.0])
    save_motion(replace(made.motion, place=made.motion.place + shift), kept.folder / f"{kept.name}.npz")
    facts = {
        "vehicle": task.vehicle.to_dict(),
        "outcome": made.result.outcome,
        "c_r": made.result.c_r,
        "path_m": made.result.path_m,
        "layers": str(kept.layers.name),
    }
    (kept.folder / f"{kept.name}.json").write_text(json.dumps(facts), encoding="utf-8")
