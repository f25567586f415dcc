"""Fitting the stripe classes of the filter method: frames in, one file out."""

from dataclasses import replace
from importlib.util import find_spec

from bumpymap.core import OutputError, Progress, SectorStack, SilentProgress, UsageError, atomic
from bumpymap.layers import name_frames, sample_evenly
from bumpymap.readers import BagTopics, find_sources
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.frames import FrameReader, naming_frame
from bumpymap.scan.polar import polar_sectors
from bumpymap.scan.stripes import StripeModel, fit_stripes, save_stripes

__all__ = ["fit_frames"]

_MOST_FITTED = 500
"""Most frames that a fit uses: neighbours in a drive see the same ground, and all heightmaps are held in memory."""


def fit_frames(config: ScanConfig, progress: Progress | None = None) -> tuple[StripeModel, dict[str, str]]:
    """Fit the stripe classes of the filter method to the frames, and write them to the file ``config.out``.

    Returns
    -------
    StripeModel
    dict
        Frames that could not be read, with the error message (``skip_bad``).

    Raises
    ------
    BumpymapError
        Bad inputs or settings, or a full disk; no file is left half-written.
    """
    progress = progress or SilentProgress()
    _check(config)
    frames = sample_evenly(name_frames(find_sources(config.frames, BagTopics(config.topic, poses=False))), _MOST_FITTED)
    reader = FrameReader(config)
    stacks: list[SectorStack] = []
    progress.start("measuring frames", len(frames))
    for frame in frames:
        with reader.skipping(frame):
            scan = reader.read(frame)
            with naming_frame(frame):
                stack = polar_sectors(scan, config.polar)
            stacks.append(_small(stack))
        progress.advance(1)
    reader.require_any(len(stacks))
    model = fit_stripes(stacks)
    with atomic(config.out) as temporary:
        save_stripes(model, temporary)
    return model, reader.skipped


def _small(stack: SectorStack) -> SectorStack:
    """Return the sectors without what a fit does not need: what is as large as the scan, and what stands on them."""
    points = {name: getattr(stack, name)[:0].copy() for name in ("point_sector", "point_ground", "point_height")}
    return replace(stack, things=stack.things[:, :0].copy(), **points)


def _check(config: ScanConfig) -> None:
    """Refuse a fit that could not be made or written, before the frames are read."""
    if find_spec("sklearn") is None:
        raise UsageError("fitting stripe classes needs scikit-learn: pip install 'bumpymap[scan]'")
    if config.out.exists() and not config.overwrite:
        raise OutputError(f"{config.out} exists already. Choose another `fit`, or pass `overwrite=True` to replace it")
    if not config.out.parent.is_dir():
        raise OutputError(f"cannot write {config.out}: there is no folder {config.out.parent}. Choose another `fit`")
