"""Choosing the method that classifies sectors, and the filter method exactly as in the paper (``compat='paper'``).

In the paper the grid does not turn with the scan. Heightmaps cover the bounding box of a sector's points in x and y,
are scaled from their lowest to their highest pixel, and empty pixels are black. The stripes are the sensor's scan lines
in such an image, so their direction depends on the azimuth. The classes are fitted in each scan, so class 0 is whatever
has the most stripes in it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASSES, ClassedSectors, PolarSettings, Scan, ScanMethod, SectorStack, UsageError, VehicleBody
from bumpymap.rating import Calibration, find_calibration
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.ground import SectorBuffers
from bumpymap.scan.learned import ScanModel, classify_learned
from bumpymap.scan.polar import polar_sectors
from bumpymap.scan.stripes import StripeFilter, classify_filter, fit_centres, load_stripes, nearest_class, stripes_in

__all__ = ["Method", "choose_method", "classify_paper", "paper_heights", "paper_settings"]


def paper_settings(settings: PolarSettings) -> PolarSettings:
    """Return the grid without what the paper does not have: ground of its own, the anchor, the overhead check.

    The default grid becomes the paper's, which has no zone nearer than 4 m.
    """
    if settings == PolarSettings():
        settings = replace(
            settings, zone_starts_m=settings.zone_starts_m[1:], sectors=settings.sectors[1:], rings=settings.rings[1:]
        )
    return replace(settings, ground_only=False, anchored=False, overhead_m=math.inf)


def classify_paper(scan: Scan, settings: PolarSettings | None = None, seed: int = 0) -> ClassedSectors:
    """Classify the sectors of one scan by the paper's rules.

    Parameters
    ----------
    scan : Scan
    settings : PolarSettings, optional
    seed : int
        Seed of k-means++.

    Returns
    -------
    ClassedSectors
        ``heights`` are the paper's, see ``paper_heights``. A scan with fewer than three different stripe counts has as
        many classes.
    """
    stack = polar_sectors(scan, paper_settings(settings or PolarSettings()))
    heights = paper_heights(scan, stack)
    stripes = stripes_in(_as_waves(heights), StripeFilter())
    different = np.unique(stripes[stack.traversable])[::-1].tolist()
    few = len(different) < CLASSES
    smooth, middle, rough = (
        [*different, *[-math.inf] * CLASSES][:CLASSES] if few else fit_centres(stripes[stack.traversable], seed, 1)
    )
    return nearest_class(replace(stack, heights=heights), stripes, (smooth, middle, rough))


def _as_waves(heights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Subtract the mean of each image, and scale it to the power of a wave of amplitude 1."""
    waves = heights - heights.mean(axis=(1, 2), keepdims=True)
    power = np.sqrt(2.0 * (waves**2).mean(axis=(1, 2), keepdims=True))
    scaled: NDArray[np.float32] = np.asarray(waves / np.where(power > 0.0, power, 1.0), np.float32)
    return scaled


def paper_heights(scan: Scan, stack: SectorStack) -> NDArray[np.float32]:
    """Return the paper's heightmaps.

    Returns
    -------
    (n, pixels, pixels) float32
        Mean z of a pixel, 0 for the lowest to 1 for the highest of the sector; north row (greatest y) first, west
        column first; 0 in pixels without points.
    """
    pixels, count = stack.settings.pixels, len(stack.zone)
    inside = np.flatnonzero(stack.point_sector >= 0)
    order = inside[np.argsort(stack.point_sector[inside], kind="stable")]
    row, xyz = stack.point_sector[order], scan.points[order].astype(np.float64)
    if not count:
        return np.zeros((0, pixels, pixels), np.float32)
    starts = np.searchsorted(row, np.arange(count))
    low, high = np.minimum.reduceat(xyz, starts), np.maximum.reduceat(xyz, starts)
    size = np.where(high > low, high - low, 1.0)
    place = np.minimum((pixels * (xyz - low[row]) / size[row]).astype(np.int64), pixels - 1)
    pixel = (row * pixels + pixels - 1 - place[:, 1]) * pixels + place[:, 0]
    cells = count * pixels * pixels
    held = np.bincount(pixel, minlength=cells)
    mean = np.bincount(pixel, xyz[:, 2], cells) / np.maximum(held, 1)
    maps = np.where(held > 0, mean, np.nan).reshape(count, -1)
    least = np.nanmin(maps, axis=1, keepdims=True)
    extent = np.nanmax(maps, axis=1, keepdims=True) - least
    scaled: NDArray[np.float64] = np.nan_to_num((maps - least) / np.where(extent > 0.0, extent, 1.0))
    return scaled.reshape(count, pixels, pixels).astype(np.float32)


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
