"""Choosing the method that classifies sectors, and loading its network or stripe classes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.resources import files

from bumpymap.core import ClassedSectors, PolarSettings, Scan, ScanMethod, UsageError, VehicleBody
from bumpymap.rating import Calibration, find_calibration
from bumpymap.scan.buffers import SectorBuffers
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.learned import ScanModel, classify_learned
from bumpymap.scan.paper import classify_paper
from bumpymap.scan.polar import polar_sectors
from bumpymap.scan.stripes import classify_filter, load_stripes

__all__ = ["Method", "choose_method"]


@dataclass(frozen=True, slots=True)
class Method:
    """The method that classifies the sectors of a run."""

    name: ScanMethod
    basis: str
    """Description of the network or the stripe classes."""
    classify: Callable[[Scan], ClassedSectors]
    """Cuts a scan into sectors and classifies them; keeps buffers for the next scan, each thread its own."""
    calibration: Calibration | None = None
    """Of the vehicle whose ride on the sectors is told; None: of none."""


def choose_method(config: ScanConfig) -> Method:
    """Choose the method according to the settings and load what it needs.

    The default is the learned method: a network trained on labels recognises mud or bushes that are as flat as grass,
    while stripes show only relief. If no network for the grid is included, the default is the filter.

    Raises
    ------
    UsageError
        No network is included, or the network or the stripe classes are for another grid. There is no such vehicle,
        or the settings name another belly or height.
    BadInputError
        The network, the stripe classes or the calibration of the vehicle cannot be read.
    """
    if not config.rates_ride:
        return _choose(config)
    from bumpymap.scan.ride import SectorRater

    calibration = find_calibration(config.vehicle or "", config.calibration)
    rater = SectorRater(calibration)
    method = _choose(replace(config, polar=_for_vehicle(config.polar, calibration.body)))

    def classify(scan: Scan) -> ClassedSectors:
        classed = method.classify(scan)
        return replace(classed, ride=rater(scan, classed.sectors))

    return replace(method, classify=classify, calibration=calibration)


def _for_vehicle(polar: PolarSettings, body: VehicleBody) -> PolarSettings:
    """Return the grid with the outline of a vehicle; raise UsageError if the settings name another one."""
    own = {"belly_m": body.lowest_obstacle_m, "height_m": body.height_m}
    for name, value in own.items():
        if getattr(polar, name) not in {value, getattr(PolarSettings(), name)}:
            raise UsageError(
                f"{name} is {getattr(polar, name)} among the settings of the polar grid, and {value} for the vehicle: "
                f"leave out {name}, or the vehicle"
            )
    return replace(polar, belly_m=own["belly_m"], height_m=own["height_m"])


def _choose(config: ScanConfig) -> Method:
    """Return the method without the ride of a vehicle."""
    if config.compat == "paper":
        return Method("filter", "stripe classes found in every scan", lambda scan: classify_paper(scan, config.polar))
    if config.model is not None or config.method == "learned" or (config.method is None and _by_network(config)):
        return _learned(config)
    stripes = load_stripes(config.stripes)
    _require_pixels(stripes.pixels, config.polar)
    centres = ", ".join(f"{centre:.2f}" for centre in stripes.centres)
    basis = f"stripe classes of {'bumpymap' if config.stripes is None else config.stripes}: {centres}"
    buffers = SectorBuffers()
    return Method("filter", basis, lambda scan: classify_filter(polar_sectors(scan, config.polar, buffers), stripes))


def _learned(config: ScanConfig) -> Method:
    model = _shipped_network() if config.model is None else ScanModel.load(config.model)
    if model is None:
        raise UsageError("no scan network is included for this; name one with `model`, or use `method='filter'`")
    model.require_pixels(config.polar)
    basis = f"scan network {model.id}"
    buffers = SectorBuffers()
    return Method("learned", basis, lambda scan: classify_learned(polar_sectors(scan, config.polar, buffers), model))


def _by_network(config: ScanConfig) -> bool:
    if config.stripes is not None:
        return False
    model = _shipped_network()
    return model is not None and config.polar.pixels == model.pixels


def _shipped_network() -> ScanModel | None:
    there = (files("bumpymap.scan") / "data" / "models" / "scan.onnx").is_file()
    return ScanModel.shipped() if there else None


def _require_pixels(pixels: int, grid: PolarSettings) -> None:
    if pixels != grid.pixels:
        raise UsageError(
            f"the stripe classes were fitted on heightmaps of {pixels} pixels, and pixels is {grid.pixels}. Fit them "
            "again with: bumpymap scan --fit"
        )
