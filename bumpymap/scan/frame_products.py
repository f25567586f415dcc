"""The products of the frames: written to a folder of the run first, and moved to their places when all are complete."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from bumpymap.core import ClassedSectors, Scan, move_together, remove_path
from bumpymap.layers import (
    ACCUMULATED_NAME,
    FRAME_FOLDER,
    SCAN_MANIFEST_NAME,
    SECTOR_TABLE_NAME,
    Frame,
    FramePart,
    FrameReport,
    SectorTable,
    ground_points,
    has_files,
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
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.merge import DriveMerge, open_merge

__all__ = ["FrameProducts", "drop_empty_folder", "move_products", "open_products", "staging_folder"]

_STAGED = "products"
"""Folder for the products, inside the folder of the run, until all are complete."""


@dataclass(frozen=True, slots=True)
class FrameProducts:
    """The products of a run while frame after frame is added."""

    config: ScanConfig
    run_folder: Path
    """Keeps what a resumed run needs of each finished frame."""
    staged: Path
    """Folder of the products until all are complete."""
    table: SectorTable | None
    """None if no table is wanted."""
    accumulated: DriveMerge | None
    """Merges the points of all frames; None without poses."""

    def load(self, frame: Frame, number: int) -> FramePart | None:
        """Return a frame that an earlier run has finished; None if it is not finished."""
        if not has_files(frame.name, self.staged, self.config.products):
            return None
        return load_part(part_path(self.run_folder, number), frame)

    def add_finished(self, frame: Frame, part: FramePart) -> None:
        """Add a frame whose own files are written already."""
        self._accumulate(frame, part)
        self._add_rows(part)

    def add(self, frame: Frame, number: int, report: FrameReport, scan: Scan, classed: ClassedSectors) -> None:
        """Write the files of a frame and add it to those of the run.

        Raises
        ------
        BadInputError
            Its points cannot be placed at its pose; nothing of it is written then.
        """
        part = self._part(report, scan, classed)
        self._accumulate(frame, part)  # first: it may refuse the frame
        write_frame(frame.name, scan, classed, self.staged, self.config.products)
        save_part(part, part_path(self.run_folder, number))
        self._add_rows(part)

    def merged(self) -> dict[str, Any] | None:
        """Return what scan.json says of the merged points, see `DriveMerge.record`; None without poses."""
        return None if self.accumulated is None else self.accumulated.record()

    def _part(self, report: FrameReport, scan: Scan, classed: ClassedSectors) -> FramePart:
        with_points = self.accumulated is not None
        return FramePart(
            report,
            sector_rows(report.frame.name, classed) if self.table is not None else None,
            scan.points if with_points else np.empty((0, 3), np.float32),
            ground_points(classed) if with_points else np.empty(0, np.bool_),
        )

    def _accumulate(self, frame: Frame, part: FramePart) -> None:
        if self.accumulated is not None and frame.pose is not None:
            self.accumulated.add_points(frame.name, part.points, frame.pose, part.is_ground)

    def _add_rows(self, part: FramePart) -> None:
        if self.table is not None and part.rows is not None:
            self.table.add_rows(part.rows)


@contextmanager
def open_products(
    config: ScanConfig, frames: Sequence[Frame], crs: CRS | None, run_folder: Path, staged: Path
) -> Iterator[FrameProducts]:
    """Open the files that take all frames; close them and flush them to disk if the body succeeds."""
    poses = [frame.pose for frame in frames if frame.pose is not None]
    with ExitStack() as open_files:
        table = open_files.enter_context(open_table(staged / SECTOR_TABLE_NAME)) if "table" in config.products else None
        merge = open_files.enter_context(open_merge(run_folder, poses[0])) if poses else None
        yield FrameProducts(config, run_folder, staged, table, merge)
        if merge is not None:
            with open_accumulated(staged / ACCUMULATED_NAME, poses[0], crs) as survey:
                merge.write(survey)
    for name in (SECTOR_TABLE_NAME, ACCUMULATED_NAME):
        if (staged / name).exists():
            sync_to_disk(staged / name)


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


def move_products(staged: Path, out: Path) -> tuple[str, ...]:
    """Move all products to ``out``, remove those of an earlier run that they do not replace; return their names."""
    files = tuple(
        name
        for name in (FRAME_FOLDER, SECTOR_TABLE_NAME, ACCUMULATED_NAME, SCAN_MANIFEST_NAME)
        if (staged / name).exists()
    )
    move_together(staged, out, SCAN_MANIFEST_NAME)
    remove_stale_products(out, files)
    return files


def drop_empty_folder(staged: Path) -> None:
    """Remove the folder of the frames' own files if there are none."""
    with suppress(OSError):
        (staged / FRAME_FOLDER).rmdir()
