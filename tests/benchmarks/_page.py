"""Format the results of a run as Markdown: targets and measured values, then the figures of every program."""

import importlib.metadata
import os
import platform
import statistics
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

__all__ = ["insert_tables", "machine", "tables"]

Results = dict[str, Any]
"""``machine``, ``surveys``, ``titles``, ``samples`` (case -> side -> records), ``patch``, ``same_bits``."""

_PACKAGES = ("bumpymap", "laspy", "lazrs", "numpy", "numba", "onnxruntime", "rasterio", "open3d", "scikit-learn")
_SIDES = {
    "read": "laspy + lazrs, every field",
    "map": "`bumpymap map`",
    "pdal": "PDAL `writers.gdal`",
    "pdal_bin": "PDAL `writers.gdal`, `binmode`",
}
_METHODS = {"open3d": "open3d", "sklearn": "scikit-learn", "both": "both, one after the other"}


def machine() -> dict[str, Any]:
    """Describe this machine (without its name) and the versions in use."""
    versions = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {
        "cores": len(os.sched_getaffinity(0)),
        "processor": _processor(),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1),
        "system": f"{platform.system()} {platform.release().split('-')[0]}",
        "versions": versions,
    }


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def tables(results: Results) -> str:
    """Return the Markdown of all tables."""
    parts = [_machine_text(results), _goals(results), _surveys(results), _sides(results), _patches(results)]
    return "\n\n".join(part for part in parts if part)


def insert_tables(page: Path, text: str, section: str = "figures") -> None:
    """Replace the text between the begin and end marks of a section of a page."""
    begin, end = f"<!-- {section}: begin -->", f"<!-- {section}: end -->"
    before, rest = page.read_text(encoding="utf-8").split(begin)
    after = rest.split(end)[1]
    page.write_text(f"{before}{begin}\n\n{text}\n\n{end}{after}", encoding="utf-8")


def _machine_text(results: Results) -> str:
    facts = results["machine"]
    versions = ", ".join(f"{name} {version}" for name, version in facts["versions"].items())
    trial = (
        ""
        if results["scale"] == 1.0
        else f" A trial with {results['scale']:g} of the points; its times are not representative."
    )
    return (
        f"{facts['processor']}, {facts['cores']} cores, {facts['memory_gb']} GB, {facts['system']}. {versions}. "
        f"Medians of {results['rounds']} round(s).{trial}"
    )


def _median(results: Results, case: str, side: str, what: str) -> float | None:
    """Return the median of one program; None if it was not run or failed."""
    records = results["samples"].get(case, {}).get(side, [])
    if not records or any("exit_code" in record for record in records):
        return None
    return float(statistics.median(record[what] for record in records))


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    body = list(rows)
    if not body:
        return ""
    lines = [head, tuple("---" for _ in head), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _goals(results: Results) -> str:
    rows = [*_speed(results), *_growth(results), *_start(results), *_patch_goals(results)]
    shown = [(label, text, goal, met) for label, text, goal, met in rows if text]
    return _table(("measure", "measured", "target", "met"), shown)


def _goal(
    label: str, values: tuple[float | None, ...], combine: Callable[..., float], unit: str, limit: tuple[str, float]
) -> tuple[str, str, str, str]:
    """Return a row of the table of targets; its measured value is empty if a figure is missing."""
    word, bound = limit
    goal = f"{word} {bound:g}{unit}"
    if any(value is None for value in values):
        return label, "", goal, ""
    value = combine(*values)
    met = value <= bound if word == "at most" else value >= bound
    return label, f"{value:.3g}{unit}", goal, "yes" if met else "no"


def _ratio(over: float, under: float) -> float:
    return over / under


def _speed(results: Results) -> list[tuple[str, str, str, str]]:
    def wall(case: str, side: str) -> float | None:
        return _median(results, case, side, "wall_s")

    rows = []
    for case, title in results["titles"].items():
        most = 1.3 if case.startswith("real") else {"20m-laz": 1.25, "20m-las": 4.0}.get(case)
        if most is not None:
            label = f"{title}: `map`, time relative to reading alone"
            rows.append(_goal(label, (wall(case, "map"), wall(case, "read")), _ratio, "", ("at most", most)))
    for side, name in (("pdal", "PDAL"), ("pdal_bin", "PDAL with `binmode`")):
        label = f"{results['titles'].get('20m-las', '')}: {name}, time relative to `map`"
        rows.append(_goal(label, (wall("20m-las", side), wall("20m-las", "map")), _ratio, "", ("at least", 4.0)))
    return rows


def _growth(results: Results) -> list[tuple[str, str, str, str]]:
    rows = []
    for order, small, large in (("sorted", "20m-laz", "200m-laz"), ("shuffled", "20m-shuffled", "200m-shuffled")):
        peaks = tuple(_median(results, case, "map", "peak_bytes") for case in (small, large))
        for size, peak in zip((20, 200), peaks, strict=True):
            label = f"peak memory, {size} million points, {order}"
            rows.append(_goal(label, (peak,), lambda value: value / 1e9, " GB", ("at most", 1.3)))
        walls = tuple(_median(results, case, "map", "wall_s") for case in (large, small))
        rows.append(_goal(f"time for 200 relative to 20 million points, {order}", walls, _ratio, "", ("at most", 10.5)))
    if results["same_bits"] is not None:
        same = all(results["same_bits"])
        label = "layers of a shuffled survey compared with the sorted one"
        rows.append((label, "same bits" if same else "other bits", "same bits", "yes" if same else "no"))
    return rows


def _start(results: Results) -> list[tuple[str, str, str, str]]:
    first, second, help_text = (
        _median(results, "start", side, "wall_s") for side in ("first run", "second run", "--help")
    )
    return [
        _goal("`bumpymap --help`", (help_text,), float, " s", ("at most", 0.3)),
        _goal(
            "first run (kernels are compiled), time added to the second",
            (first, second),
            lambda once, again: once - again,
            " s",
            ("at most", 15.0),
        ),
    ]


def _patch_goals(results: Results) -> list[tuple[str, str, str, str]]:
    rows = []
    for title, records in results["patch"].items():
        ours = statistics.median(record["ours_ms"] for record in records)
        for way in records[0]["methods_ms"]:
            theirs = statistics.median(record["methods_ms"][way] for record in records)
            label = f"a patch of {title}: the paper's method with {_METHODS[way]}, time relative to ours"
            rows.append(_goal(label, (theirs, ours), _ratio, "", ("at least", 100.0)))
    return rows


def _surveys(results: Results) -> str:
    rows = []
    for case, fact in results["surveys"].items():
        density = f"{fact['points'] / fact['area_m2']:.0f}" if "area_m2" in fact else ""
        size = f"{fact['width_m']:.0f} x {fact['depth_m']:.0f} x {fact['height_m']:.0f} m"
        rows.append(
            (
                results["titles"][case],
                f"{fact['points']:,}",
                f"{fact['bytes'] / 1e6:,.0f} MB",
                fact["kind"],
                size,
                density,
            )
        )
    return _table(("survey", "points", "size", "format", "extent", "points/m2"), rows)


def _sides(results: Results) -> str:
    rows = []
    for case, sides in results["samples"].items():
        for side, records in sides.items():
            name = _SIDES.get(side, f"`bumpymap`, {side}")
            failed = [record for record in records if "exit_code" in record]
            if failed:
                rows.append((results["titles"][case], name, f"failed (exit {failed[0]['exit_code']})", "", ""))
                continue
            wall, cpu, peak = ([record[key] for record in records] for key in ("wall_s", "cpu_s", "peak_bytes"))
            spread = f"{statistics.median(wall):.2f} ({min(wall):.2f} to {max(wall):.2f})"
            rows.append(
                (
                    results["titles"][case],
                    name,
                    spread,
                    f"{statistics.median(cpu):.2f}",
                    f"{statistics.median(peak) / 1e9:.2f}",
                )
            )
    return _table(("case", "program", "wall time [s]", "processor time [s]", "peak memory [GB]"), rows)


def _patches(results: Results) -> str:
    rows = []
    steps = ("heightmap", "variance", "open3d", "sklearn", "class")
    for title, records in results["patch"].items():
        theirs = [[record["steps_ms"].get(step) for record in records] for step in steps]
        ours = statistics.median(record["ours_ms"] for record in records)
        shown = ("" if None in values else f"{statistics.median(values):.3f}" for values in theirs)
        rows.append((title, f"{records[0]['points_per_tile']:,}", f"{ours:.3f}", *shown))
    head = (
        "patches of",
        "points per patch",
        "bumpymap, all steps [ms]",
        "heightmap",
        "variance",
        "open3d",
        "scikit-learn",
    )
    return _table((*head, "class"), rows)
