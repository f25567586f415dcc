"""Classing all frames of a run, and writing their products."""

import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from pyproj import CRS

from bumpymap.core import ClassedSectors, Kept, Progress, RunFolder, Scan, Stopwatch, utf8_path
from bumpymap.layers import (
    Frame,
    FrameReport,
    explain_empty_scan,
    has_finished_parts,
    output_errors,
    report_frame,
    write_scan_manifest,
)
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.frame_products import (
    FrameProducts,
    drop_empty_folder,
    move_products,
    open_products,
    staging_folder,
)
from bumpymap.scan.frames import FrameReader, naming_frame
from bumpymap.scan.methods import Method
from bumpymap.scan.run_record import ClassifiedFrames, scan_manifest

__all__ = ["FrameRun"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class FrameRun:
    """The frames of a run, and how they are classed."""

    config: ScanConfig
    frames: Sequence[Frame]
    method: Method
    crs: CRS | None
    """Of the poses; None: local coordinates."""
    run_spec: dict[str, Any]
    """See `describe_scan`."""

    def classify(self, progress: Progress, clock: Stopwatch) -> ClassifiedFrames:
        """Class the frames that an earlier run has not finished, and write the products of all of them.

        Raises
        ------
        BumpymapError
            Bad frames, or a full disk; products in ``config.out`` are replaced when all new ones are complete.
        """
        out, reader = self.config.out, FrameReader(self.config)
        with self._run_folder() as run, output_errors(out), utf8_path(staging_folder(run.path, self.frames)) as staged:
            with (
                clock.stage("scan"),
                open_products(self.config, self.frames, self.crs, run.path, staged) as products,
            ):
                reports = self._classify_each(reader, products, progress)
            accumulated = products.merged()
            manifest = scan_manifest(self.config, self.frames, self.method, self.run_spec, reader.skipped)
            manifest |= {"gathered": accumulated, "seconds": clock.seconds}
            drop_empty_folder(staged)
            write_scan_manifest(staged, manifest, reports, self.run_spec["inputs"])
            files = move_products(staged, out)
        return ClassifiedFrames(files, self.method.name, tuple(reports), reader.skipped, accumulated, clock.seconds)

    def _run_folder(self) -> AbstractContextManager[RunFolder]:
        how = "in the place of `overwrite=True`" if self.config.overwrite else "to the same command"
        return RunFolder.opened(
            self.config.out,
            self.run_spec,
            resume=self.config.resume,
            finished=has_finished_parts,
            advice=f"Pass `resume=True` {how} to continue from the finished frames.",
            decide=lambda _: Kept.ALL,
        )

    def _classify_each(self, reader: FrameReader, products: FrameProducts, progress: Progress) -> list[FrameReport]:
        reports: list[FrameReport] = []
        progress.start("scanning frames", len(self.frames))
        for number, frame in enumerate(self.frames):
            with reader.skipping(frame):
                reports.append(self._classify_one(frame, number, reader, products))
            progress.advance(1)
        reader.require_any(len(reports))
        return reports

    def _classify_one(self, frame: Frame, number: int, reader: FrameReader, products: FrameProducts) -> FrameReport:
        """Read, class and write a frame; one that an earlier run has finished is only added to the products."""
        finished = products.load(frame, number)
        if finished is not None:
            products.add_finished(frame, finished)
            return finished.report
        version: Mapping[str, Any] = self.run_spec["inputs"][str(frame.path)]
        scan, classed, seconds = self._classify_scan(frame, reader)
        report = report_frame(frame, version, scan, classed, seconds)
        products.add(frame, number, report, scan, classed)
        return report

    def _classify_scan(self, frame: Frame, reader: FrameReader) -> tuple[Scan, ClassedSectors, float]:
        """Read a frame and class its sectors; also return the time that both took, s."""
        begin = time.perf_counter()
        scan = reader.read(frame)
        with naming_frame(frame):
            classed = self.method.classify(scan)
        seconds = time.perf_counter() - begin
        if reason := explain_empty_scan(scan, classed):
            _log.warning("no ground was classified in %s: %s", frame.path, reason)
        return scan, classed, seconds
