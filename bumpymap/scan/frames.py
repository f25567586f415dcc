"""The frames of a scan run, bad ones skipped, and their products, moved to their places when all are complete."""

import logging
import math
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from bumpymap.core import BadInputError, ClassedSectors, Frame, GroundGrid, Scan, move_together, remove_path
from bumpymap.layers import (
    ACCUMULATED_NAME,
    FRAME_FOLDER,
    SCAN_MANIFEST_NAME,
    SECTOR_TABLE_NAME,
    FramePart,
    FrameReport,
    SectorTable,
    file_sizes,
    frame_files,
    load_part,
    open_accumulated,
    open_table,
    part_path,
    remove_stale_products,
    save_part,
    sector_rows,
    sync_to_disk,
    write_frame,
)
from bumpymap.readers import BagReader, NoPointsError, deskew, read_message, read_scan
from bumpymap.scan.align import nearest_ranges
from bumpymap.scan.cells import FrameView, GroundMemory, SeenCells, see_cells
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.merge import DriveMerge, PlacedPoints, open_merge

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
    """Reads frames; bad ones end the run, or are skipped if the settings say so."""

    def __init__(self, config: ScanConfig) -> None:
        self._config = config
        self.skipped: dict[str, str] = {}
        """Origin -> error message of each frame that was skipped."""
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

    @contextmanager
    def skipping(self, frame: Frame) -> Iterator[None]:
        """Skip the frame if the body of the ``with`` raises BadInputError and ``skip_bad`` is set, or it is empty."""
        try:
            yield
        except BadInputError as error:
            if not (self._config.skip_bad or isinstance(error, NoPointsError)):
                error.add_note("`skip_bad=True` goes on without such frames.")
                raise
            _log.warning("skipped %s: %s", frame.origin, error)
            self.skipped[frame.origin] = str(error)

    def require_any(self, count: int) -> None:
        """Raise BadInputError, with the reasons, if no frame could be read."""
        if not count:
            reasons = list(self.skipped.values())
            more = [f"{len(reasons) - _NAMED} more"] if len(reasons) > _NAMED else []
            raise BadInputError("none of the frames could be read:", *reasons[:_NAMED], *more)


_STAGED = "products"
"""Folder for the products, inside the folder of the run, until all are complete."""


@dataclass(frozen=True, slots=True)
class FrameProducts:
    """The products of a run while frame after frame is added.

    Several threads may `load` and `write` frames at a time; one alone may `add` them, in their order.
    """

    config: ScanConfig
    run_folder: Path
    """Keeps what a resumed run needs of each finished frame."""
    staged: Path
    """Folder of the products until all are complete."""
    table: SectorTable | None
    """None if no table is wanted."""
    accumulated: DriveMerge | None
    """Merges the points of all frames; None without poses."""

    def load(self, frame: Frame, number: int) -> tuple[FramePart, PlacedPoints | None] | None:
        """Return what `write` returns, of a frame that an earlier run has finished; None if it is not finished."""
        part = load_part(part_path(self.run_folder, number), frame)
        if part is None or part.files != file_sizes(self._files(frame, number)):
            return None
        return part, self._place(frame, number, part.points, part.is_ground)

    def write(
        self,
        frame: Frame,
        number: int,
        report: FrameReport,
        scan: Scan,
        classed: ClassedSectors,
        draw: Callable[[Scan, ClassedSectors, Path, float], None],
    ) -> tuple[FramePart, PlacedPoints | None]:
        """Write the files of a frame's own, and its checkpoint; return what is added, and its points at its pose.

        ``draw`` writes the picture of classed points, up to a distance [m], to a file. Raises BadInputError: its points
        cannot be placed at its pose; there are no files of its own then.
        """
        products, stack = frame_products(self.config, number), classed.sectors
        placed = self._place(frame, number, scan.points, stack.point_ground)  # first: it may refuse the frame
        write_frame(frame.name, scan, classed, self.staged, products)
        for path in frame_files(frame.name, self.staged, {"picture"} & set(products)):
            draw(scan, classed, path, self.config.range_m)
        seen = None if self.config.bag is None else see_cells(scan.points, classed, self.config.grid, frame.pose)
        kept = slice(None) if self.accumulated is not None else slice(0)
        part = FramePart(
            report,
            sector_rows(frame.name, classed) if self.table is not None else None,
            scan.points[kept],
            stack.point_ground[kept],
            {} if seen is None else {name: np.asarray(values) for name, values in seen._asdict().items()},
            file_sizes(self._files(frame, number)) or {},
        )
        save_part(part, part_path(self.run_folder, number))
        return part, placed

    def add(self, part: FramePart, placed: PlacedPoints | None) -> None:
        """Add a frame to the files of the run."""
        if self.accumulated is not None and placed is not None:
            self.accumulated.add_points(placed)
        if self.table is not None and part.rows is not None:
            self.table.add_rows(part.rows)

    def grids(self, frames: Sequence[Frame]) -> Iterator[tuple[Frame, int, GroundGrid]]:
        """Yield the grids of the finished ones of all frames, with these and their numbers.

        Those with poses are what is remembered until then, one for what several sensors see in turn.
        """
        memory, held = GroundMemory(self.config.grid), dict[str, tuple[Frame, int, FrameView]]()

        def remember() -> Iterator[tuple[Frame, int, GroundGrid]]:
            if held:
                frame, number, _ = [*held.values()][-1]
                views = [view for _, _, view in held.values()]
                yield frame, number, memory.add(views, views[0].pose)
                held.clear()

        for number, frame in enumerate(frames):
            part = load_part(part_path(self.run_folder, number), frame)
            if part is None:  # skipped
                continue
            topic = "" if frame.message is None else frame.message.topic
            if frame.pose is None or topic in held:
                yield from remember()
            cells: Any = part.cells
            seen = SeenCells(**cells)
            if frame.pose is None:
                yield frame, number, seen.finish(self.config.grid.resolution_m)
            else:
                held[topic] = frame, number, FrameView(frame.pose, seen, nearest_ranges(part.points))
        yield from remember()

    def _place(
        self, frame: Frame, number: int, points: NDArray[np.float32], is_ground: NDArray[np.bool_]
    ) -> PlacedPoints | None:
        """Place points (n, 3) at the pose of the frame; if that is refused, remove the files of its own."""
        if self.accumulated is None or frame.pose is None:
            return None
        try:
            return self.accumulated.place_points(frame.name, points, frame.pose, is_ground)
        except BadInputError:
            for path in (part_path(self.run_folder, number), *self._files(frame, number)):
                path.unlink(missing_ok=True)
            raise

    def _files(self, frame: Frame, number: int) -> list[Path]:
        return frame_files(frame.name, self.staged, frame_products(self.config, number))


def frame_products(config: ScanConfig, number: int) -> tuple[str, ...]:
    """Return the products of the frame with that number in the run."""
    return (*config.products, *(["picture"] if config.pictures and number % config.pictures == 0 else []))


@contextmanager
def open_products(
    config: ScanConfig, frames: Sequence[Frame], crs: CRS | None, run_folder: Path, staged: Path
) -> Iterator[FrameProducts]:
    """Open the files that take all frames, and close them after the body."""
    poses = [frame.pose for frame in frames if frame.pose is not None]
    with ExitStack() as open_files:
        table = open_files.enter_context(open_table(staged / SECTOR_TABLE_NAME)) if "table" in config.products else None
        how = {"trusted": config.trust_poses, "corrected": config.correct_poses}
        merge = open_files.enter_context(open_merge(run_folder, poses[0], config.robot, **how)) if poses else None
        yield FrameProducts(config, run_folder, staged, table, merge)
        if merge is not None:
            with open_accumulated(staged / ACCUMULATED_NAME, poses[0], crs) as survey:
                merge.write(survey)


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


def present_products(folder: Path) -> tuple[str, ...]:
    """Return the names of the products of a run that are in a folder, without the map of the drive."""
    names = (FRAME_FOLDER, SECTOR_TABLE_NAME, ACCUMULATED_NAME, SCAN_MANIFEST_NAME)
    return tuple(name for name in names if (folder / name).exists())


def move_products(staged: Path, out: Path) -> tuple[str, ...]:
    """Move all products to ``out``, remove those of an earlier run that they do not replace; return their names."""
    files = present_products(staged)
    sync_to_disk(path for path in staged.rglob("*") if path.is_file())
    move_together(staged, out, SCAN_MANIFEST_NAME)
    remove_stale_products(out, files)
    return files
