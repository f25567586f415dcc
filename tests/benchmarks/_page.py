"""Format the results of a run as Markdown: targets and measured values, then the figures of every program."""

import importlib.metadata
import os
import platform
import re
import shutil
import statistics
import subprocess
from pathlib import Path
from typing import Any

from _targets import goals, table

__all__ = ["insert_tables", "machine", "tables"]

Results = dict[str, Any]
"""What ``run.py`` writes: ``machine``, ``surveys``, ``titles``, ``samples`` (case -> side -> records), ..."""

_PACKAGES = ("bumpymap", "laspy", "lazrs", "numpy", "numba", "onnxruntime", "rasterio", "open3d", "scikit-learn")
_SIDES = {
    "read": "laspy + lazrs, every field",
    "map": "`bumpymap map`",
    "map_1gb": "`bumpymap map --memory 1GB`",
    "before": "`bumpymap map`, before",
    "before_1gb": "`bumpymap map --memory 1GB`, before",
    "pdal": "PDAL `writers.gdal`",
    "pdal_bin": "PDAL `writers.gdal`, `binmode`",
}


def machine() -> dict[str, Any]:
    """Describe this machine (without its name) and the versions in use."""
    versions = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    if pdal := _pdal():
        versions["PDAL"] = pdal
    return {
        "cores": len(os.sched_getaffinity(0)),
        "processor": _processor(),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1),
        "system": f"{platform.system()} {platform.release().split('-')[0]}",
        "versions": versions,
    }


def _pdal() -> str | None:
    """Return the version of PDAL on the path; None if there is none."""
    pdal = shutil.which("pdal")
    if pdal is None:
        return None
    told = subprocess.run([pdal, "--version"], capture_output=True, text=True, check=False).stdout
    found = re.search(r"pdal (\d[\d.]*)", told)
    return found[1] if found else None


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def tables(results: Results) -> str:
    """Return the Markdown of all tables."""
    parts = [_machine_text(results), _goals(results), _surveys(results), _sides(results)]
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
        f"Medians of as many runs as the last table says.{trial}"
    )


def _goals(results: Results) -> str:
    shown = [row for row in goals(results) if row[1]]
    return table(("measure", "measured", "target", "met"), shown)


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
    return table(("survey", "points", "size", "format", "extent", "points/m2"), rows)


def _sides(results: Results) -> str:
    rows = []
    for case, sides in results["samples"].items():
        for side, records in sides.items():
            name = _SIDES.get(side, f"`bumpymap`, {side}")
            failed = [record for record in records if "exit_code" in record]
            if failed:
                rows.append((results["titles"][case], name, f"failed (exit {failed[0]['exit_code']})", "", "", "", ""))
                continue
            walls = [record["wall_s"] for record in records]
            middle = {key: statistics.median(record[key] for record in records) for key in records[0]}
            rows.append(
                (
                    results["titles"][case],
                    name,
                    f"{middle['wall_s']:.2f} ({min(walls):.2f} to {max(walls):.2f})",
                    f"{middle['user_s']:.2f}",
                    f"{middle['system_s']:.2f}",
                    f"{middle['peak_bytes'] / 1e9:.2f}",
                    str(len(records)),
                )
            )
    head = ("case", "program", "wall time [s]", "user time [s]", "system time [s]", "peak memory [GB]", "runs")
    return table(head, rows)
