"""Agreement of the classes of scans from two sensors and of rotated scans, and what a scan costs.

    python tests/benchmarks/scan_checks.py [FRAMES] [--scenes 44] [--pairs 11] [--repeats 50]

Without frames, scenes that no network was trained on are simulated, and some are seen by a sensor of 64 lines at 1.7 m
and by one of 32 lines at 1 m. The cost is from points in memory to classes, beside that of the filter method written
sector by sector with scikit-learn, SciPy and scikit-image.
"""

import argparse
import math
import time
import tracemalloc
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASSES, ClassedSectors, PolarSettings, Scan, point_classes
from bumpymap.lab.evaluate.report import number, table
from bumpymap.lab.evaluate.scans import read_frames, simulated_scans
from bumpymap.lab.settings import ScanEvaluateSettings
from bumpymap.lab.train.scan_sectors import UNSEEN
from bumpymap.readers import find_frames
from bumpymap.scan import ScanModel, StripeModel, classify_filter, classify_learned, load_stripes, polar_sectors
from bumpymap.scan.stripes import StripeFilter

_LEAST_INLIER_M = 0.1


def plain_classes(scan: Scan, model: StripeModel, settings: PolarSettings | None = None) -> tuple[int, list[int]]:
    """Classify the sectors of a scan by the filter method, one after another.

    Returns
    -------
    sectors : int
        Number of sectors with enough points.
    classes : list of int
        Classes of the traversable ones, in no particular order.
    """
    from sklearn.decomposition import PCA
    from sklearn.linear_model import RANSACRegressor

    settings = settings or PolarSettings()
    points = scan.points.astype(np.float64)
    distance = np.hypot(points[:, 0], points[:, 1])
    azimuth = np.mod(np.arctan2(points[:, 1], points[:, 0]), 2 * math.pi)
    edges = (*settings.zone_starts_m, settings.end_m)
    sectors, classes = 0, []
    for zone, (count, rings) in enumerate(zip(settings.sectors, settings.rings, strict=True)):
        bounds = np.linspace(edges[zone], edges[zone + 1], rings + 1)
        for ring in range(rings):
            for sector in range(count):
                low, high = 2 * math.pi * sector / count, 2 * math.pi * (sector + 1) / count
                inside = (
                    (distance >= bounds[ring]) & (distance < bounds[ring + 1]) & (azimuth >= low) & (azimuth < high)
                )
                if inside.sum() <= settings.least_points:
                    continue
                sectors += 1
                own = points[inside]
                if abs(PCA(3).fit(own).components_[2, 2]) < settings.least_normal_z:
                    continue
                place = np.stack([(distance[inside] - bounds[ring]), azimuth[inside] - low], axis=1)
                heights = _heightmap(place, own[:, 2], (bounds[ring + 1] - bounds[ring], high - low), settings.pixels)
                own[:, 2].var()
                RANSACRegressor(residual_threshold=_LEAST_INLIER_M, random_state=0).fit(own[:, :2], own[:, 2])
                stripes = _stripes(heights, model.filter)
                classes.append(int(np.abs(np.array(model.centres) - stripes).argmin()))
    return sectors, classes


def _heightmap(
    place: NDArray[np.float64], z: NDArray[np.float64], size: tuple[float, float], pixels: int
) -> NDArray[np.float64]:
    """Return the mean z per pixel, with holes filled from the nearest pixel and the plane removed."""
    from scipy.ndimage import distance_transform_edt
    from scipy.stats import binned_statistic_2d

    limits = ((0.0, size[0]), (0.0, size[1]))
    heights = binned_statistic_2d(place[:, 0], place[:, 1], z, "mean", pixels, limits).statistic
    nearest = distance_transform_edt(np.isnan(heights), return_distances=False, return_indices=True)
    filled = heights[tuple(nearest)]
    row, column = np.indices(filled.shape)
    terms = np.stack([np.ones(filled.size), row.ravel(), column.ravel()], axis=1)
    plane = terms @ np.linalg.lstsq(terms, filled.ravel(), rcond=None)[0]
    level: NDArray[np.float64] = filled - plane.reshape(filled.shape)
    return level


def _stripes(heights: NDArray[np.float64], settings: StripeFilter) -> float:
    """Draw stripes over the heights, apply eight Gabor filters and count stripes along the columns."""
    from scipy.ndimage import convolve
    from skimage.filters import gabor_kernel

    rows = np.arange(len(heights))[:, None]
    waves = np.cos(2 * math.pi * (rows / settings.wavelength_px + heights / settings.metres_per_stripe))
    seen: NDArray[np.bool_] = np.zeros(waves.shape, np.bool_)
    for turn in range(settings.orientations):
        theta = math.pi * turn / settings.orientations
        kernel: NDArray[np.float64] = np.asarray(gabor_kernel(1 / settings.wavelength_px, theta, bandwidth=1)).real
        down, right = np.indices(kernel.shape) - (np.array(kernel.shape) // 2)[:, None, None]
        own = np.cos(2 * math.pi * (right * math.cos(theta) + down * math.sin(theta)) / settings.wavelength_px)
        seen |= convolve(waves, kernel / (kernel * own).sum()) >= settings.threshold
    starts = seen[1:] & ~seen[:-1]
    return float((starts.sum() + seen[0].sum()) / len(seen))


CELL_M = 0.5
END_M = 30.0
_AROUND = round(2 * END_M / CELL_M)
_MOUNTS_M = (1.7, 1.0)
"""Height of the sensor of 64 lines, and of that of 32."""


@dataclass(frozen=True, slots=True)
class SensorAgreement:
    """Cells of 0.5 m within 30 m that both sensors give a class."""

    cells: int
    same: int
    """Those with the same class."""


def scene_pairs(seed: int, scenes: range) -> Iterator[tuple[Scan, Scan]]:
    """Simulate scenes with a sensor of 64 lines and with a lower one of 32 at the same place."""
    from bumpymap.lab.worlds.scans.lidar import SENSORS, simulate_scan
    from bumpymap.lab.worlds.scans.scene import make_scene

    sensors = [
        replace(SENSORS[name], height_m=height)
        for name, height in zip(("64_blocks", "32_sparse"), _MOUNTS_M, strict=True)
    ]
    for index in scenes:
        scene = make_scene(seed, index)
        seen = [simulate_scan(scene, sensor, index) for sensor in sensors]
        first, second = (Scan(scan.points[scan.points.any(axis=1)], name=f"{index}") for scan in seen)
        yield first, second


def cell_classes(scan: Scan, classed: ClassedSectors) -> NDArray[np.int16]:
    """Return the most frequent class of the points of each cell around the sensor (the smaller if tied).

    Returns
    -------
    (n * n,) array
        Row by row; -1 without a point in a classified sector.
    """
    class_id = point_classes(scan, classed)
    place = np.floor((scan.points[:, :2].astype(np.float64) + END_M) / CELL_M).astype(np.int64)
    near = np.hypot(scan.points[:, 0], scan.points[:, 1]) < END_M
    there = near & (class_id < CLASSES) & ((place >= 0) & (place < _AROUND)).all(axis=1)
    cell = place[there, 0] * _AROUND + place[there, 1]
    counts = np.bincount(cell * CLASSES + class_id[there], minlength=_AROUND**2 * CLASSES).reshape(-1, CLASSES)
    return np.where(counts.any(axis=1), counts.argmax(axis=1), -1).astype(np.int16)


def agreement(pair: tuple[Scan, Scan], classify: Callable[[Scan], ClassedSectors]) -> SensorAgreement:
    """Compare the classes of two scans of one place, in one frame of x and y."""
    first, second = (cell_classes(scan, classify(scan)) for scan in pair)
    both = (first >= 0) & (second >= 0)
    return SensorAgreement(int(both.sum()), int((both & (first == second)).sum()))


def sum_agreements(each: Sequence[SensorAgreement]) -> SensorAgreement:
    """Add the counts of many places."""
    return SensorAgreement(sum(one.cells for one in each), sum(one.same for one in each))


def turn_scan(scan: Scan, angle: float) -> Scan:
    """Rotate a scan about z by ``angle`` radians, counter-clockwise."""
    cos, sin = math.cos(angle), math.sin(angle)
    about_z = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return replace(scan, points=(scan.points.astype(np.float64) @ about_z.T).astype(np.float32))


def kept_share(scan: Scan, classify: Callable[[Scan], ClassedSectors], angles: Sequence[float]) -> float:
    """Return the share of points that keep their class in rotated scans, mean over the angles; NaN without points."""
    if not len(scan.points):
        return float("nan")
    still = point_classes(scan, classify(scan))
    shares = []
    for angle in angles:
        other = turn_scan(scan, angle)
        shares.append(float(np.mean(point_classes(other, classify(other)) == still)))
    return float(np.mean(shares))


_FULL_TURN = 131_072
"""Beams of the sensor for which times are measured: 64 lines, 2,048 columns."""


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
            peak_bytes(classify, scan) / 1e6,
        )
        for name, classify in methods.items()
    ]


def peak_bytes(classify: Callable[[Scan], ClassedSectors], scan: Scan) -> int:
    """Return the peak memory that Python allocates while a scan is classified, bytes."""
    tracemalloc.start()
    try:
        classify(scan)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def plain_cost(scan: Scan, model: StripeModel) -> PlainCost:
    """Time the plain implementation once."""
    begin = time.process_time_ns()
    sectors, _ = plain_classes(scan, model)
    return PlainCost(sectors, (time.process_time_ns() - begin) / 1e6)


@dataclass(frozen=True, slots=True)
class KeptRow:
    """Points that keep their class in rotated scans."""

    method: str
    mean: float
    """Over the scans, 0..1."""
    least: float


def full_turn(scan: Scan, seed: int) -> Scan:
    """Resample a scan to one point per beam of the sensor, by repeating or omitting points at random."""
    rows = np.random.default_rng(seed).permutation(np.resize(np.arange(len(scan.points)), _FULL_TURN))
    return Scan(scan.points[np.sort(rows)], name=scan.name)


def show_records(title: str, rows: Sequence[Any]) -> None:
    """Print dataclasses of one kind as a Markdown table, a row each; nothing without rows."""
    if rows:
        cells = [
            [number(value, 4) if isinstance(value, float) else str(value) for value in asdict(row).values()]
            for row in rows
        ]
        print("\n".join([f"## {title}", "", *table(list(asdict(rows[0])), cells)]), flush=True)


def main() -> None:
    """Print a table for each check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", nargs="?", type=Path)
    parser.add_argument("--scenes", type=int, default=44)
    parser.add_argument("--pairs", type=int, default=11)
    parser.add_argument("--turns", type=int, default=8)
    parser.add_argument("--repeats", type=int, default=50)
    parser.add_argument("--seed", type=int, default=7)
    given = parser.parse_args()
    stripes, network = load_stripes(None), ScanModel.shipped()
    methods: dict[str, Callable[[Scan], ClassedSectors]] = {
        "filter": lambda scan: classify_filter(polar_sectors(scan), stripes),
        "learned": lambda scan: classify_learned(polar_sectors(scan), network),
    }
    settings = ScanEvaluateSettings(scenes=given.scenes, seed=given.seed)
    scans = read_frames(find_frames([given.frames])) if given.frames else simulated_scans(settings)
    angles = np.random.default_rng(given.seed).uniform(0.0, 2 * math.pi, given.turns).tolist()
    kept: dict[str, list[float]] = {name: [] for name in methods}
    fullest = None
    for scan in scans:
        for name, classify in methods.items():
            kept[name].append(kept_share(scan, classify, angles))
        if fullest is None or abs(len(scan.points) - _FULL_TURN) < abs(len(fullest.points) - _FULL_TURN):
            fullest = scan
    rows = [KeptRow(name, float(np.nanmean(own)), float(np.nanmin(own))) for name, own in kept.items()]
    show_records("Rotated scans", rows)
    if not given.frames:
        found: dict[str, list[SensorAgreement]] = {name: [] for name in methods}
        for pair in scene_pairs(given.seed, range(UNSEEN, UNSEEN + given.pairs)):
            for name, classify in methods.items():
                found[name].append(agreement(pair, classify))
        show_records("One place, two sensors: filter, learned", [sum_agreements(own) for own in found.values()])
    if fullest is not None:
        show_records("Costs of a scan", method_costs(full_turn(fullest, given.seed), methods, range(given.repeats)))
        show_records("Sector by sector", [plain_cost(fullest, stripes)])


if __name__ == "__main__":
    main()
