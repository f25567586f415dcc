"""The frames of a scan run: reading them, and skipping bad ones."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Lock

from bumpymap.core import BadInputError, Scan
from bumpymap.layers import Frame
from bumpymap.readers import (
    BagReader,
    LabelSet,
    deskew,
    label_set,
    read_message,
    read_scan,
    require_label_set,
)
from bumpymap.scan.config import ScanConfig

__all__ = ["FrameReader", "naming_frame"]

_log = logging.getLogger(__name__)

_NAMED = 5
"""Number of frames that a message names."""


class FrameReader:
    """Reads frames; bad ones end the run, or are skipped if the settings say so.

    Parameters
    ----------
    config : ScanConfig
    """

    def __init__(self, config: ScanConfig) -> None:
        self._config = config
        self._labels: LabelSet | None = None if config.labels is None else label_set(config.labels)
        self.skipped: dict[str, str] = {}
        """Origin -> error message of each frame that was skipped."""
        self._bags: dict[Path, BagReader] = {}
        self._lock = Lock()
        self._told_of_no_labels = False

    def read(self, frame: Frame) -> Scan:
        """Read a frame; deskew it if its points have times. Raises BadInputError if it cannot be read."""
        if frame.message is not None:
            scan = read_message(self._bag(frame.path), frame.message, self._config.robot, frame.name)
        else:
            scan = replace(read_scan(frame.path, self._config.robot, self._config.columns), name=frame.name)
        if self._labels is not None and scan.label is not None:
            require_label_set(scan.label, self._labels, frame.origin)
        elif self._labels is not None:
            self._tell_of_no_labels()
        return scan if frame.motion is None or not self._config.deskew else deskew(scan, frame.motion)

    def _tell_of_no_labels(self) -> None:
        """Say once that there is nothing to check the label set with."""
        with self._lock:
            told, self._told_of_no_labels = self._told_of_no_labels, True
        if not told:
            _log.warning(
                "there are frames without labels, so `labels` was not checked for them. Labels of DIR/NAME.bin are in "
                "NAME.label in DIR, or in a folder labels beside it"
            )

    def _bag(self, path: Path) -> BagReader:
        """Return a bag, which is opened once."""
        with self._lock:
            if path not in self._bags:
                self._bags[path] = BagReader(path)
            return self._bags[path]

    @contextmanager
    def skipping(self, frame: Frame) -> Iterator[None]:
        """Skip the frame if the body of the ``with`` raises BadInputError and ``skip_bad`` is set."""
        try:
            yield
        except BadInputError as error:
            if not self._config.skip_bad:
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


@contextmanager
def naming_frame(frame: Frame) -> Iterator[None]:
    """Add the origin of the frame to the message of a BadInputError."""
    try:
        yield
    except BadInputError as error:
        raise BadInputError(f"cannot classify {frame.origin}: {error}") from error
