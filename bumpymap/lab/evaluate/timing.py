"""Measure time and memory per tile of each step, from points in memory to a rated tile, on one thread."""

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from bumpymap.core import Georeference, PatchStack, Progress, counted
from bumpymap.lab.evaluate.subject import MAPPED, Subject
from bumpymap.lab.evaluate.survey import MeasuredSurvey
from bumpymap.rating import classify

__all__ = ["PAPER", "StepCost", "peak_bytes", "step_costs"]

_LEAST_TILES = 256
_REPEATS = 7
PAPER = {
    "heightmap_ms": 12.257,
    "heightmap_kb": 0.084,
    "variance_and_residual_ms": 41.027,
}
"""The paper's Table II, per patch."""


@dataclass(frozen=True, slots=True)
class StepCost:
    """Cost of one step on a batch of tiles."""

    step: str
    tiles: int
    points: int
    processor_ms: float
    """CPU time per tile, median of the repeats."""
    peak_kb: float
    """Peak memory per tile allocated by the step, including its result but not its input."""
    result_kb: float
    """Size of the result per tile."""


def step_costs(survey: MeasuredSurvey, subject: Subject, progress: Progress) -> list[StepCost]:
    """Time the steps on one batch of tiles: the first block with enough of them, or the one with most.

    CPU time is measured rather than wall time, so that other programs on the machine have little influence.
    """
    points = next(survey.points())
    for candidate in survey.points():
        if len(candidate.col) > len(points.col):
            points = candidate
        if len(points.col) >= _LEAST_TILES:
            break
    patches = survey.measured(points)
    textures = classify(patches, subject.textures)
    steps: dict[str, Callable[[], Any]] = {
        "measure": lambda: survey.measured(points),
        "texture": lambda: classify(patches, subject.textures),
    }
    for name in MAPPED:
        if name in subject.ratings:
            rating = subject.ratings[name]
            steps[name] = lambda rating=rating: rating(patches, textures, Georeference(None))  # type: ignore[misc]
    tiles, count = len(points.col), int(patches.count.sum())
    progress.start("timing steps", len(steps))
    timed = counted(steps.items(), progress)
    return [StepCost(name, tiles, count, *_cost(step, patches, tiles)) for name, step in timed]


def _cost(step: Callable[[], Any], patches: PatchStack, tiles: int) -> tuple[float, float, float]:
    """Return milliseconds, peak kB and result kB per tile."""
    result = step()
    spent = []
    for _ in range(_REPEATS):
        begin = time.process_time_ns()
        step()
        spent.append(time.process_time_ns() - begin)
    own = {id(getattr(patches, f.name)) for f in fields(PatchStack)}
    size = sum(_bytes(getattr(result, f.name), own) for f in fields(result))
    return float(np.median(spent)) / 1e6 / tiles, peak_bytes(step) / 1000 / tiles, size / 1000 / tiles


def peak_bytes(step: Callable[[], Any]) -> int:
    """Return the peak memory that Python allocates while a step runs, bytes."""
    tracemalloc.start()
    try:
        step()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def _bytes(value: Any, own: set[int]) -> int:
    """Return the size of an array in bytes; 0 if it is part of the input."""
    return int(value.nbytes) if isinstance(value, np.ndarray) and id(value) not in own else 0
