"""The targets of the benchmarks, and whether the figures of a run meet them."""

import statistics
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

__all__ = ["goals", "table"]

Results = dict[str, Any]
Row = tuple[str, str, str, str]
"""Measure, measured value (empty if there is none), target, whether it is met."""

_GB = 1e9
_PDAL = {"real": (1.5, 1.2), "20m-laz": (1.7, 1.4), "20m-las": (3.5, 2.8)}
"""Case -> least time of PDAL, and of PDAL with ``binmode``, relative to ``map``."""
_READING = {"real": 1.5, "20m-laz": 1.1, "20m-las": 4.0}
"""Case -> most time of ``map`` relative to reading alone."""


@dataclass(frozen=True, slots=True)
class _Limit:
    """A target."""

    word: str
    """``at most`` or ``at least``."""
    bound: float
    unit: str = ""


def table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """Return a table as Markdown; nothing if it has no rows."""
    body = list(rows)
    if not body:
        return ""
    lines = [head, tuple("---" for _ in head), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def goals(results: Results) -> list[Row]:
    """Return all targets, with the figures that were measured."""
    parts = (_speed, _before, _machine_use, _growth, _same_bits, _start)
    return [row for part in parts for row in part(results)]


def _median(results: Results, case: str, side: str, what: str) -> float | None:
    """Return the median of one program; None if it was not run or failed."""
    records = results["samples"].get(case, {}).get(side, [])
    if not records or any("exit_code" in record for record in records):
        return None
    return float(statistics.median(record[what] for record in records))


def _goal(label: str, values: Iterable[float | None], combine: Callable[..., float], limit: _Limit) -> Row:
    """Return a row; its measured value is empty if a figure is missing."""
    goal = f"{limit.word} {limit.bound:g}{limit.unit}"
    found = list(values)
    if any(value is None for value in found):
        return label, "", goal, ""
    value = combine(*found)
    met = value <= limit.bound if limit.word == "at most" else value >= limit.bound
    return label, f"{value:.3g}{limit.unit}", goal, "yes" if met else "no"


def _ratio(over: float, under: float) -> float:
    return over / under


def _kind(case: str) -> str:
    """Return ``real`` for any real survey, else the case itself."""
    return "real" if case.startswith("real") else case


def _speed(results: Results) -> list[Row]:
    rows = []
    for case, title in results["titles"].items():
        if _kind(case) not in _PDAL:
            continue
        wall = {side: _median(results, case, side, "wall_s") for side in ("read", "map", "pdal", "pdal_bin")}
        least = dict(zip(("pdal", "pdal_bin"), _PDAL[_kind(case)], strict=True))
        for side, name in (("pdal", "PDAL"), ("pdal_bin", "PDAL with `binmode`")):
            label = f"{title}: {name}, time relative to `map`"
            rows.append(_goal(label, (wall[side], wall["map"]), _ratio, _Limit("at least", least[side])))
        label = f"{title}: `map`, time relative to reading alone"
        limit = _Limit("at most", _READING[_kind(case)])
        rows.append(_goal(label, (wall["map"], wall["read"]), _ratio, limit))
    return rows


def _before(results: Results) -> list[Row]:
    """Compare whole commands with another version; only the sample survey has a target."""
    rows = []
    for case, title in results["titles"].items():
        for what, name in (("wall_s", "time"), ("cpu_s", "processor time")):
            values = [_median(results, case, side, what) for side in ("map", "before")]
            label = f"{title}: `map`, {name} relative to the version before"
            row = _goal(label, values, _ratio, _Limit("at most", 0.7))
            rows.append(row if case == "sample" else (*row[:2], "", ""))
    return rows


def _machine_use(results: Results) -> list[Row]:
    """Return time in the kernel, bytes read and memory of a large uncompressed survey."""
    case, rows = "20m-las", []
    title = results["titles"].get(case, "")
    times = [_median(results, case, "map", what) for what in ("system_s", "user_s")]
    rows.append(_goal(f"{title}: `map`, system time relative to user time", times, _ratio, _Limit("at most", 0.2)))
    size = results["surveys"].get(case, {}).get("bytes")
    for side, name in (("map", "`map`"), ("before", "`map`, before")):
        read = results["bytes_read"].get(case, {}).get(side, {})
        label = f"{title}: {name}, bytes read of the survey relative to its size"
        row = _goal(label, (read.get("survey"), size), _ratio, _Limit("at most", 1.05))
        rows.append(row if side == "map" else (*row[:2], "", ""))
        label = f"{title}: {name}, bytes read of all files relative to the size of the survey"
        rows.append((*_goal(label, (read.get("all"), size), _ratio, _Limit("at most", 0))[:2], "", ""))
    for side, name in (("map_1gb", "`map --memory 1GB`"), ("before_1gb", "`map --memory 1GB`, before")):
        row = _goal(
            f"{title}: {name}, peak memory", (_peak(results, case, side),), float, _Limit("at most", 0.7, " GB")
        )
        rows.append(row if side == "map_1gb" else (*row[:2], "", ""))
    return rows


def _peak(results: Results, case: str, side: str) -> float | None:
    """Return the median of the peak memory, GB."""
    peak = _median(results, case, side, "peak_bytes")
    return None if peak is None else peak / _GB


def _growth(results: Results) -> list[Row]:
    rows = []
    for order, small, large in (("sorted", "20m-laz", "200m-laz"), ("shuffled", "20m-shuffled", "200m-shuffled")):
        for size, case in ((20, small), (200, large)):
            label = f"peak memory with `--memory 1GB`, {size} million points, {order}"
            rows.append(_goal(label, (_peak(results, case, "map_1gb"),), float, _Limit("at most", 1.3, " GB")))
        walls = [_median(results, case, "map_1gb", "wall_s") for case in (large, small)]
        label = f"time for 200 relative to 20 million points, `--memory 1GB`, {order}"
        rows.append(_goal(label, walls, _ratio, _Limit("at most", 10.5)))
    for case in ("100m-laz", "100m-copc", "1000m-laz", "1000m-copc"):
        title = results["titles"].get(case, "")
        wall, peak = _median(results, case, "map", "wall_s"), _peak(results, case, "map")
        if wall is not None and peak is not None:
            points = results["surveys"][case]["points"]
            speed = f"{wall:,.0f} s, {points / wall / 1e6:.2f} million points/s, {peak:.2f} GB"
            rows.append((f"{title}: `map`, time, speed, peak memory", speed, "", ""))
    return rows


def _same_bits(results: Results) -> list[Row]:
    """Return a row for every reason why layers of one survey might differ."""
    rows = []
    for kind in dict.fromkeys(kind for kind, _ in results["same_bits"].values()):
        other = [name for name, (each, same) in results["same_bits"].items() if each == kind and not same]
        measured = f"other bits: {', '.join(other)}" if other else "same bits"
        rows.append((f"layers compared with those of {kind}", measured, "same bits", "no" if other else "yes"))
    return rows


def _start(results: Results) -> list[Row]:
    first, second, help_text = (
        _median(results, "start", side, "wall_s") for side in ("first run", "second run", "--help")
    )
    label = "first run (kernels are compiled), time added to the second"
    return [
        _goal("`bumpymap --help`", (help_text,), float, _Limit("at most", 0.1, " s")),
        _goal(label, (first, second), lambda once, again: once - again, _Limit("at most", 15.0, " s")),
    ]
