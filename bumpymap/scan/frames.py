"""The frames of a scan run, bad ones skipped, and their products, moved to their places when all are complete."""

import logging
import math
import shlex
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, Frame, GroundGrid, Progress, Scan, remove_path
from bumpymap.layers import (
    FRAME_FOLDER,
    FramePart,
    explain_empty_scan,
    frame_files,
    load_part,
    part_path,
    report_frame,
    save_part,
    sector_rows,
    write_cloud,
)
from bumpymap.readers import BagReader, NoPointsError, deskew, read_message, read_scan
from bumpymap.scan.cells import FrameView, GroundMemory, SeenCells, see_cells
from bumpymap.scan.classifier import Method
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.merge import place_points
from bumpymap.views import write_picture
from bumpytiles import run_blocks

_log = logging.getLogger(__name__)

_NAMED = 5
"""Number of frames that a message names."""
_SWEEP_M, _FAR_SHARE = 30.0, 0.45
"""Least radius without the farthest 2 % of the points, m, and least share of points beyond half of it, of a map of many
scans. One scan has 7 to 22 % there (13 scans of 8 sensors), points that are even over the ground 65 to 70 %."""


def _looks_registered(points: NDArray[np.float32]) -> bool:
    """Return whether points (n, 3) are spread as those of a map and not as those of one scan."""
    reach = np.hypot(points[:, 0], points[:, 1])
    radius = float(np.quantile(reach, 0.98)) if reach.size else 0.0
    return radius > _SWEEP_M and float(np.mean(reach > 0.5 * radius)) > _FAR_SHARE


class FrameReader:
    """Reads frames from files and bags, deskewed if the settings say so."""

    def __init__(self, config: ScanConfig) -> None:
        self._config = config
        self._bags: dict[tuple[Path, str], BagReader] = {}
        """By bag and topic: each reads on where it was."""
        self._lock = Lock()
        self._doubted = False

    def read(self, frame: Frame) -> Scan:
        """Read a frame; deskew it if its points have times. Raises BadInputError if it cannot be read."""
        if frame.message is not None:
            place = (frame.path, frame.message.topic)
            with self._lock:
                if place not in self._bags:
                    self._bags[place] = BagReader(frame.path)
            scan = read_message(self._bags[place], frame.message, self._config.robot, frame.name)
        else:
            scan = replace(read_scan(frame.path, self._config.robot, self._config.columns), name=frame.name)
            if frame.pose is None and not self._doubted and _looks_registered(scan.points):
                self._doubted = True
                _log.warning(
                    "%s looks like a map of many scans, not like one: its points do not get fewer with the distance "
                    "from the sensor. If it is one: bumpymap map %s --local --out DIR",
                    frame.path,
                    shlex.quote(str(frame.path)),
                )
        if frame.pose is not None:
            scan = replace(scan, heading_rad=math.atan2(frame.pose[1, 0], frame.pose[0, 0]))
        return scan if frame.motion is None or not self._config.deskew else deskew(scan, frame.motion)


_STAGED = "products"
"""Folder for the products, inside the folder of the run, until all are complete."""


@dataclass(frozen=True, slots=True)
class FrameWork:
    """The way of the frames of a run from their files to their products."""

    config: ScanConfig
    method: Method
    inputs: Mapping[str, Any]
    """Identities of files by their paths, see `bumpymap.readers.identity`."""
    run_folder: Path
    """Keeps what a resumed run needs of each finished frame."""
    staged: Path
    """Folder of the products until all are complete."""
    offset: NDArray[np.float64] | None
    """(3,) of the coordinates of the merged points, m; None without poses."""
    reader: FrameReader
    skipped: dict[str, str] = field(default_factory=dict)
    """Origin -> error message of each frame that was skipped."""

    def finished(self, frames: Sequence[Frame], progress: Progress) -> Generator[tuple[Frame, FramePart], None, None]:
        """Yield the frames in order, with what they add to the files of the run; several are worked on at a time.

        Raises BadInputError: a frame is bad, and `skip_bad` is not set; or all are.
        """
        progress.start("scanning frames", len(frames))
        is_any = False
        with closing(run_blocks(self._attempt, enumerate(frames), self.config.threads)) as results:
            for frame, found in zip(frames, results, strict=True):
                if isinstance(found, BadInputError):
                    self._skip(frame, found)
                else:
                    part, empty = found
                    if empty:
                        _log.warning("no ground was classified in %s: %s", frame.origin, empty)
                    is_any = True
                    yield frame, part
                progress.advance(1)
        if not is_any:
            reasons = list(self.skipped.values())
            more = [f"{len(reasons) - _NAMED} more"] if len(reasons) > _NAMED else []
            raise BadInputError("none of the frames could be read:", *reasons[:_NAMED], *more)

    def _attempt(self, numbered: tuple[int, Frame]) -> tuple[FramePart, str] | BadInputError:
        try:
            return self._finish(*numbered)
        except BadInputError as error:  # raised when it is the frame's turn: it may be skipped
            return error

    def _skip(self, frame: Frame, error: BadInputError) -> None:
        if not (self.config.skip_bad or isinstance(error, NoPointsError)):
            error.add_note("`skip_bad=True` goes on without such frames.")
            raise error
        _log.warning("skipped %s: %s", frame.origin, error)
        self.skipped[frame.origin] = str(error)

    def _finish(self, number: int, frame: Frame) -> tuple[FramePart, str]:
        """Read, class and write a frame, unless an earlier run has; return also why it has no ground, or nothing."""
        files, checkpoint = self._files(number, frame), part_path(self.run_folder, number)
        part = load_part(checkpoint, frame.name, files)
        if part is not None:
            return part, ""
        begin = time.perf_counter()
        scan = self.reader.read(frame)
        try:
            classed = self.method.classify(scan)
        except BadInputError as error:
            raise BadInputError(f"cannot classify {frame.origin}: {error}") from error
        entry = report_frame(frame, self.inputs.get(str(frame.path)), scan, classed, time.perf_counter() - begin)
        arrays: dict[str, NDArray[Any]] = {}
        if self.offset is not None and frame.pose is not None:
            is_ground = classed.sectors.point_ground
            arrays |= place_points(frame.name, scan.points, is_ground, frame.pose, self.offset)
        if self.config.bag is not None:
            arrays |= see_cells(scan.points, classed, self.config.grid, frame.pose)._asdict()
        products = frame_products(self.config, number)
        if "cloud" in products:
            write_cloud(scan, classed, files[0])
        if "picture" in products:
            write_picture(scan, classed, files[-1], self.config.range_m)
        rows = sector_rows(frame.name, classed) if "table" in self.config.products else None
        part = FramePart(entry, rows, arrays)
        save_part(part, checkpoint, files)
        return part, explain_empty_scan(scan, classed)

    def _files(self, number: int, frame: Frame) -> list[Path]:
        return frame_files(frame.name, self.staged, frame_products(self.config, number))

    def grids(self, frames: Sequence[Frame]) -> Iterator[tuple[Frame, int, GroundGrid]]:
        """Yield the grids of the finished ones of all frames, with these and their numbers.

        Those with poses are what is remembered until then, one for what several sensors see in turn.
        """
        turns: list[dict[str | None, tuple[int, Frame]]] = []
        for number, frame in enumerate(frames):
            sensor = None if frame.pose is None else "" if frame.message is None else frame.message.topic
            if frame.origin not in self.skipped:
                if not turns or sensor is None or turns[-1].keys() & {sensor, None}:
                    turns.append({})
                turns[-1][sensor] = number, frame
        memory = GroundMemory(self.config.grid)
        for turn in turns:
            number, frame = [*turn.values()][-1]
            views = [self._view(*each) for each in turn.values()]
            alone = frame.pose is None
            grid = views[0].cells.finish(self.config.grid.resolution_m) if alone else memory.add(views, views[0].pose)
            yield frame, number, grid

    def _view(self, number: int, frame: Frame) -> FrameView:
        part = load_part(part_path(self.run_folder, number), frame.name, self._files(number, frame))
        arrays: dict[str, Any] = part.arrays  # type: ignore[union-attr]
        cells = SeenCells(*(arrays[name] for name in SeenCells._fields))
        if frame.pose is None:
            return FrameView(np.eye(4), cells, np.empty(0, np.uint16))
        return FrameView(frame.pose, cells, arrays["view"]["ranges"][0])


def frame_products(config: ScanConfig, number: int) -> tuple[str, ...]:
    """Return the products of the frame with that number in the run."""
    return (*config.products, *(["picture"] if config.pictures and number % config.pictures == 0 else []))


def staging_folder(run_folder: Path, frames: Sequence[Frame]) -> Path:
    """Return the folder for products that are not complete; of an earlier run only files of finished frames stay."""
    staged = run_folder / _STAGED
    (staged / FRAME_FOLDER).mkdir(parents=True, exist_ok=True)
    for left in staged.iterdir():
        if left.name != FRAME_FOLDER:
            remove_path(left)
    finished = {frame.name for number, frame in enumerate(frames) if part_path(run_folder, number).exists()}
    for left in (staged / FRAME_FOLDER).iterdir():
        if left.stem not in finished:
            remove_path(left)
    return staged
