"""``bumpymap evaluate --routes``: drive along ways over the layers of a map and compare with what it predicts."""

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bumpymap.cli._options import given_options
from bumpymap.cli._terminal import DRIVES_KEPT, interrupt_note
from bumpymap.cli._text import print_line
from bumpymap.core import Progress, UsageError, locked

if TYPE_CHECKING:
    from bumpymap.lab import RouteFindings
    from bumpymap.rating import Calibration

__all__ = ["evaluate_routes_over", "summarise_routes"]

_SETTINGS = {"pairs": "total_pairs", "repeats": "repeats", "seed": "seed"}


def evaluate_routes_over(
    folders: tuple[Any, ...],
    out: Path,
    given: dict[str, Any],
    progress: AbstractContextManager[Progress],
    check_place: Callable[[], None],
) -> "tuple[RouteFindings, list[Path]]":
    """Evaluate ways over the layers in folders and write the report; return the findings and the files."""
    from bumpymap.lab import (
        RoutePlanner,
        RouteTrialSettings,
        TrialOptions,
        evaluate_routes,
        require_calibration,
        require_dart,
        require_matplotlib,
        write_route_report,
    )
    from bumpymap.layers import open_map

    require_matplotlib()
    require_dart()
    chosen = {own: given[name] for name, own in _SETTINGS.items() if name in given_options(given)}
    settings = RouteTrialSettings(**chosen)
    route_map = open_map([Path(folder) for folder in folders])
    calibration = _calibration(given, route_map.vehicle.name)
    require_calibration(route_map, calibration)
    with locked(out), interrupt_note(DRIVES_KEPT), progress as shown:
        check_place()
        options = TrialOptions(out, given["workers"] or os.cpu_count() or 1, given["overwrite"], shown)
        plan = RoutePlanner.of(route_map)
        findings, data = evaluate_routes(route_map, calibration, plan, settings, options)
        return findings, write_route_report(findings, data, out)


def _calibration(given: dict[str, Any], vehicle: str) -> "Calibration":
    """Return the given calibration, or that of the vehicle that the map names."""
    from bumpymap.rating import find_calibration

    if len(given["vehicle"]) + len(given["calibration"]) > 1:
        raise UsageError(
            "--routes drives the vehicle that the layers were made for; give one --vehicle or --calibration"
        )
    file = given["calibration"][0] if given["calibration"] else None
    try:
        return find_calibration(given["vehicle"][0] if given["vehicle"] else vehicle, file)
    except UsageError as error:
        if given["vehicle"] or file:
            raise
        raise UsageError(
            f"the layers were made for {vehicle}, which is no included vehicle: give its file with --calibration"
        ) from error


def summarise_routes(findings: "RouteFindings", files: list[Path]) -> None:
    """Print the figures of an evaluation."""
    from bumpymap.lab import number, percent

    for name, own in findings.agreement.items():
        arrived = findings.arrivals[name]
        print_line(
            f"{name:8s} {own.ways} ways compared, median error {percent(own.median_error)}, predicted / driven "
            f"{number(own.median_ratio)}; arrived {percent(arrived.arrived)}, predicted {percent(arrived.expected)}"
        )
    found = findings.order
    print_line(f"best way against straight line: right on {found.right} of {found.compared} pairs")
    print_line(f"wrote {files[0]}")
