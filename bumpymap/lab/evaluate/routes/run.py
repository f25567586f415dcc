"""Evaluate routes: plan ways over the layers of a map, drive along them, compare."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, TileField
from bumpymap.lab.evaluate.routes.compare import (
    Arrivals,
    GroundRow,
    PairOrder,
    WayAgreement,
    WayResult,
    agree,
    arrivals,
    by_class,
    order,
    results_of,
)
from bumpymap.lab.evaluate.routes.measured import driven_field, ride_without_correction
from bumpymap.lab.evaluate.routes.pairs import PlanWay, WayPair, choose_pairs
from bumpymap.lab.evaluate.routes.predicted import predict_line
from bumpymap.lab.evaluate.routes.settings import RouteTrialSettings
from bumpymap.lab.evaluate.routes.trial import WAYS, drive_pairs
from bumpymap.lab.evaluate.trial import TrialOptions
from bumpymap.rating import Calibration, RideModel, Vehicle

if TYPE_CHECKING:
    from bumpymap.layers import RouteMap

__all__ = ["RouteFindings", "evaluate_routes", "require_calibration"]


@dataclass(frozen=True, slots=True)
class RouteFindings:
    """All results of an evaluation of routes."""

    facts: dict[str, Any]
    settings: dict[str, Any]
    ways: list[WayResult]
    agreement: dict[str, WayAgreement]
    """``best``, ``straight`` -> agreement of C_r."""
    arrivals: dict[str, Arrivals]
    order: PairOrder
    ground: list[GroundRow]

    def of(self, name: str) -> list[WayResult]:
        """Return the ways of one kind, in the order of the pairs."""
        return [way for way in self.ways if way.name == name]


@dataclass(frozen=True, slots=True)
class RouteTrialData:
    """What the pictures need beside the findings."""

    field: TileField
    pairs: list[WayPair]


def require_calibration(route_map: "RouteMap", calibration: Calibration) -> None:
    """Raise BadInputError if the map was made with another calibration."""
    if route_map.calibration_id != calibration.id:
        raise BadInputError(
            f"the layers were made with the calibration {route_map.calibration_id} of {route_map.vehicle.name}; the "
            f"given one is {calibration.id} of {calibration.vehicle['name']}. Give its file with --calibration, or map "
            "the survey again"
        )


def evaluate_routes(
    route_map: "RouteMap",
    calibration: Calibration,
    plan: PlanWay,
    settings: RouteTrialSettings,
    options: TrialOptions,
) -> tuple[RouteFindings, RouteTrialData]:
    """Plan the best ways between random places of a map, drive them and the straight lines, and compare.

    Parameters
    ----------
    route_map : RouteMap
    calibration : Calibration
        The one that the map was made with; it has a ride model.
    plan : callable
        See `PlanWay`.
    settings : RouteTrialSettings
    options : TrialOptions

    Raises
    ------
    BadInputError
        The map was made with another calibration, is damaged, or has no two places with a way between them.
    """
    require_calibration(route_map, calibration)
    field = route_map.read(route_map.window)
    pairs = choose_pairs(field, plan, settings, options.progress)
    c_r_raw = _raw(route_map, calibration, field, pairs)
    lines = {(number, name): line for number, pair in enumerate(pairs) for name, line in pair.lines().items()}
    profile = Vehicle.from_dict(calibration.vehicle, f"calibration {calibration.id}")
    field = driven_field(field, calibration.floor)
    predicted = {key: predict_line(field, line, c_r_raw) for key, line in lines.items()}
    driven = drive_pairs(route_map, profile, pairs, settings, options)
    ways = results_of(field, lines, predicted, driven)
    best, straight = ([way for way in ways if way.name == name] for name in WAYS)
    facts = {
        "vehicle": route_map.vehicle.name,
        "calibration": calibration.id,
        "inputs": [str(one["path"]).rpartition("/")[2] for each in route_map.manifests for one in each["inputs"]],
        "tiles": int(np.isfinite(field.c_r).sum()),
        "passable": int((field.barred == 0).sum()),
        "pairs": len(pairs),
    }
    findings = RouteFindings(
        facts=facts,
        settings=asdict(settings),
        ways=ways,
        agreement={"best": agree(best), "straight": agree(straight)},
        arrivals={"best": arrivals(best), "straight": arrivals(straight)},
        order=order(best, straight),
        ground=by_class(field, c_r_raw, best, calibration.class_limits),
    )
    return findings, RouteTrialData(field, pairs)


def _raw(
    route_map: "RouteMap", calibration: Calibration, field: TileField, pairs: Sequence[WayPair]
) -> NDArray[np.float64]:
    """Predict without noise correction the tiles along and beside the ways."""
    from scipy.ndimage import binary_dilation

    near = np.zeros(field.c_r.shape, np.bool_)
    for pair in pairs:
        for line in pair.lines().values():
            for a, b in pairwise(line):
                share = np.linspace(0, 1, int(np.hypot(*(b - a)) * 4) + 2)[:, None]
                row, col = np.floor(a + share * (b - a)).astype(np.int64).T
                near[row, col] = True
    known = binary_dilation(near, iterations=2) & np.isfinite(field.c_r)
    return ride_without_correction(RideModel(calibration), route_map.heights(route_map.window), known)
