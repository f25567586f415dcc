"""Measure time and memory from the points of a scan in memory to classified sectors."""

import importlib.util
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from bumpymap.core import ClassedSectors, Scan, UsageError
from bumpymap.lab.evaluate.scan.plain import plain_classes
from bumpymap.lab.evaluate.timing import peak_bytes
from bumpymap.scan import StripeModel

__all__ = ["PAPER_SECTOR_MS", "MethodCost", "PlainCost", "method_costs", "plain_cost", "require_libraries"]

PAPER_SECTOR_MS = {"filter": 3.228, "learned": 7.626}
"""The paper's times per sector, ms."""


def require_libraries(*, simulates: bool) -> None:
    """Raise UsageError if a library that the evaluation needs is not installed, before the work starts."""
    wanted = {"sklearn": "scikit-learn", "skimage": "scikit-image"} | ({"open3d": "open3d"} if simulates else {})
    missing = [name for module, name in wanted.items() if importlib.util.find_spec(module) is None]
    if missing:
        extras = "scan,o3d" if simulates else "scan"
        raise UsageError(f"evaluate --scans needs {' and '.join(missing)}: pip install 'bumpymap[{extras}]'")


@dataclass(frozen=True, slots=True)
class MethodCost:
    """Cost of one method on one scan."""

    method: str
    points: int
    sectors: int
    scan_ms: float
    """Wall time, median of the repeats."""
    processor_ms: float
    """CPU time of all threads, median of the repeats."""
    peak_mb: float
    """Peak memory that Python allocated, without the scan."""

    @property
    def sector_ms(self) -> float:
        """CPU time per sector."""
        return self.processor_ms / self.sectors if self.sectors else float("nan")


@dataclass(frozen=True, slots=True)
class PlainCost:
    """Cost of the plain implementation on the same scan."""

    sectors: int
    processor_ms: float
    """CPU time of one run over the whole scan."""

    @property
    def sector_ms(self) -> float:
        """CPU time per sector."""
        return self.processor_ms / self.sectors if self.sectors else float("nan")


def method_costs(
    scan: Scan, methods: Mapping[str, Callable[[Scan], ClassedSectors]], repeats: Iterable[int]
) -> list[MethodCost]:
    """Time all methods alternately in every repeat, so that other load on the machine affects all of them."""
    for classify in methods.values():
        classify(scan)
    clock: dict[str, list[int]] = {name: [] for name in methods}
    processor: dict[str, list[int]] = {name: [] for name in methods}
    sectors = 0
    for _ in repeats:
        for name, classify in methods.items():
            begin, spent = time.perf_counter_ns(), time.process_time_ns()
            sectors = len(classify(scan).class_id)
            clock[name].append(time.perf_counter_ns() - begin)
            processor[name].append(time.process_time_ns() - spent)
    return [
        MethodCost(
            name,
            len(scan.points),
            sectors,
            float(np.median(clock[name])) / 1e6,
            float(np.median(processor[name])) / 1e6,
            peak_bytes(partial(classify, scan)) / 1e6,
        )
        for name, classify in methods.items()
    ]


def plain_cost(scan: Scan, model: StripeModel) -> PlainCost:
    """Time the plain implementation once."""
    begin = time.process_time_ns()
    sectors, _ = plain_classes(scan, model)
    return PlainCost(sectors, (time.process_time_ns() - begin) / 1e6)
