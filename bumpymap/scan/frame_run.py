"""Classing all frames of a run, and writing their products."""

import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from pyproj import CRS

from bumpymap.core import Kept, Progress, RunFolder, Stopwatch, in_threads, utf8_path
from bumpymap.layers import (
    Frame,
    FrameReport,
    describe_file,
    explain_empty_scan,
    has_finished_parts,
    output_errors,
    report_frame,
    write_scan_manifest,
)
from bumpymap.scan.agreement import WrongPosesError
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.frame_products import (
    FinishedFrame,
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
            manifest |= {"gathered": accumulated, "bag": None, "seconds": clock.seconds}
            if self.config.bag is not None and products.grids is not None:
                done = {report.frame.name for report in reports}
                products.grids.write(self.config.bag, (n for n, f in enumerate(self.frames) if f.name in done))
                manifest["bag"] = describe_file(self.config.bag)
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
            decide=lambda end: Kept.NOTHING if isinstance(end, WrongPosesError) else Kept.ALL,
        )

    def _classify_each(self, reader: FrameReader, products: FrameProducts, progress: Progress) -> list[FrameReport]:
        """Read, class and write frames in threads; add them to the files of the run in their order."""

        def finish(numbered: tuple[int, Frame]) -> tuple[FinishedFrame, str]:
            return self._finish(*numbered, reader, products)

        reports: list[FrameReport] = []
        progress.start("scanning frames", len(self.frames))
        with in_threads(finish, enumerate(self.frames), self.config.threads) as results:
            for frame, result in zip(self.frames, results, strict=True):
                with reader.skipping(frame):
                    finished, empty = result()
                    if empty:
                        _log.warning("no ground was classified in %s: %s", frame.origin, empty)
                    products.add(finished)
                    reports.append(finished.part.report)
                progress.advance(1)
        reader.require_any(len(reports))
        return reports

    def _finish(
        self, number: int, frame: Frame, reader: FrameReader, products: FrameProducts
    ) -> tuple[FinishedFrame, str]:
        """Read and class a frame and write its files, unless an earlier run has; also return why it has no ground."""
        finished = products.load(frame, number)
        if finished is not None:
            return finished, ""
        version: Mapping[str, Any] | None = self.run_spec["inputs"].get(str(frame.path))
        begin = time.perf_counter()
        scan = reader.read(frame)
        with naming_frame(frame):
            classed = self.method.classify(scan)
        report = report_frame(frame, version, scan, classed, time.perf_counter() - begin)
        return products.write(frame, number, report, scan, classed), explain_empty_scan(scan, classed)
