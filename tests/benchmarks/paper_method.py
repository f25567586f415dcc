"""Time the tiles of a survey one by one with the paper's method, and all at once with bumpymap.

python tests/benchmarks/paper_method.py SURVEY [--tiles 200]

Both get the same points, already read and split into tiles. ``run.py`` limits both to one thread (OMP_NUM_THREADS=1).
Expensive parts of the paper's code are left out: no image files are written, and the small texture network of bumpymap
replaces ResNet-50 on 224 x 224 pixels.
"""

import argparse
import importlib
import json
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from numpy.typing import NDArray

from bumpymap.core.config import FeatureSettings
from bumpymap.core.onnx_file import onnx_runtime
from bumpymap.core.types import Georeference
from bumpymap.patches.features import measure
from bumpymap.rating.calibration import Calibration
from bumpymap.rating.cost import rate
from bumpymap.rating.textures import TextureModel, classify
from bumpytiles import Grid, TilePoints

Points = NDArray[np.float64]
"""(n, 3) easting, northing, upward, m."""

_SIZE, _PIXELS = 3.0, 15
_THRESHOLD = 0.1
"""Maximum distance of inliers from a plane, as in ``FeatureSettings``, m."""
_ITERATIONS = 1000
"""Number of planes that open3d tries, as in its own examples."""
_LEAST_POINTS = 30
_REACH = 14
"""Maximum distance of chosen tiles from the central tile, in tiles."""


@dataclass(frozen=True, slots=True)
class Cut:
    """Tiles with their points."""

    col: NDArray[np.int64]
    row: NDArray[np.int64]
    points: list[Points]
    """One (n, 3) array per tile, in random order: a sorted order would favour a sampler that uses the first points."""


def cut(path: Path, tiles: int) -> Cut:
    """Read a survey (in metres) and cut out the ``tiles`` nearest to its middle that have enough points."""
    near = []
    with laspy.open(path, laz_backend=laspy.LazBackend.LazrsParallel) as reader:
        middle = np.floor((reader.header.mins + reader.header.maxs)[:2] / 2 / _SIZE)
        for chunk in reader.chunk_iterator(1_000_000):
            points = np.stack([chunk.x, chunk.y, chunk.z], axis=1)
            away = np.abs(np.floor(points[:, :2] / _SIZE) - middle).max(axis=1)
            near.append(points[away <= _REACH])
    points = np.random.default_rng(1).permutation(np.concatenate(near))
    place, tile, count = np.unique(np.floor(points[:, :2] / _SIZE), axis=0, return_inverse=True, return_counts=True)
    parts = np.split(points[np.argsort(tile.ravel(), kind="stable")], np.cumsum(count)[:-1])
    order = np.argsort(np.abs(place - middle).max(axis=1), kind="stable")
    chosen = order[count[order] >= _LEAST_POINTS][:tiles]
    col, row = (np.ascontiguousarray(axis) for axis in place[chosen].astype(np.int64).T)
    return Cut(col, row, [parts[i] for i in chosen])


def paper_heightmap(points: Points, west: float, south: float) -> NDArray[np.uint8]:
    """Make the paper's patch (15, 15): heights scaled to 0..255; the last point of each pixel is used."""
    low, high = points[:, 2].min(), points[:, 2].max()
    scaled = (points[:, 2] - low) / (high - low) * 255
    col = ((points[:, 0] - west) / _SIZE * (_PIXELS - 1)).astype(int)
    row = ((points[:, 1] - south) / _SIZE * (_PIXELS - 1)).astype(int)
    patch = np.zeros((_PIXELS, _PIXELS), np.uint8)
    patch[row, col] = scaled.astype(np.uint8)
    return patch


def open3d_residual(points: Points) -> float:
    """Return the mean distance of the points to the plane that open3d finds, m."""
    import open3d

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    a, b, c, d = cloud.segment_plane(_THRESHOLD, 3, _ITERATIONS)[0]
    return float(np.mean(np.abs(points @ (a, b, c) + d)) / np.sqrt(a * a + b * b + c * c))


def planes() -> dict[str, Callable[[Points], float]]:
    """Return the plane fits that are available here; open3d is a large package that needs system libraries."""
    methods: dict[str, Callable[[Points], float]] = {"open3d": open3d_residual, "sklearn": sklearn_residual}
    for name in tuple(methods):
        try:
            importlib.import_module(name)
        except (ImportError, OSError) as error:
            sys.stderr.write(f"{name} is left out: {error}\n")
            del methods[name]
    return methods


def sklearn_residual(points: Points) -> float:
    """Return the mean distance of the points to the plane that scikit-learn finds, m."""
    from sklearn.linear_model import RANSACRegressor

    found = RANSACRegressor(residual_threshold=_THRESHOLD, random_state=1).fit(points[:, :2], points[:, 2])
    slope = found.estimator_.coef_
    off = points[:, 2] - found.predict(points[:, :2])
    return float(np.mean(np.abs(off)) / np.sqrt(1.0 + slope @ slope))


def paper_parts(tiles: Cut) -> dict[str, list[float]]:
    """Time each step of the paper's method on each tile, s."""
    runtime = onnx_runtime()
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1
    network = runtime.InferenceSession(TextureModel.shipped().content, options)
    seconds: dict[str, list[float]] = {}
    methods = planes()

    def timed(step: str, work: Callable[..., Any], *given: Any) -> Any:
        started = time.perf_counter()
        result = work(*given)
        seconds.setdefault(step, []).append(time.perf_counter() - started)
        return result

    for warm_up in (True, False):
        seconds.clear()
        for col, row, points in zip(tiles.col, tiles.row, tiles.points[: 3 if warm_up else None], strict=False):
            local = points - points.mean(axis=0)
            patch = timed("heightmap", paper_heightmap, points, col * _SIZE, row * _SIZE)
            timed("variance", np.var, points[:, 2])
            for name, residual in methods.items():
                timed(name, residual, local)
            timed("class", network.run, None, {"patches": (patch / 255).astype(np.float32)[None, None]})
    return seconds


def ours(tiles: Cut, rounds: int) -> float:
    """Time bumpymap on all tiles at once: measure, classify, rate; median of the rounds, s."""
    points = np.concatenate(tiles.points)
    block = TilePoints(
        grid=Grid(_SIZE, _PIXELS),
        col=tiles.col,
        row=tiles.row,
        starts=np.cumsum([0, *map(len, tiles.points)]),
        easting=points[:, 0].copy(),
        northing=points[:, 1].copy(),
        upward=points[:, 2].copy(),
        flag=np.zeros(len(points), np.bool_),
    )
    model, calibration, settings = TextureModel.shipped(), Calibration.shipped("warthog"), FeatureSettings()
    seconds = []
    for _ in range(rounds + 1):
        started = time.perf_counter()
        patches = measure(block, settings, ground_only=False)
        rate(patches, classify(patches, model), calibration, Georeference(None))
        seconds.append(time.perf_counter() - started)
    return statistics.median(seconds[1:])  # the first one loads the kernels


def main() -> None:
    """Print one line of JSON: ms per tile of both methods, and of each step of the paper's."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("survey", type=Path, help="LAS or LAZ, in metres")
    parser.add_argument("--tiles", type=int, default=200)
    given = parser.parse_args()
    tiles = cut(given.survey, given.tiles)
    if not tiles.points:
        parser.error(f"{given.survey} has no tile of {_LEAST_POINTS} points near its middle; name another survey")
    mean = {step: 1e3 * statistics.fmean(seconds) for step, seconds in paper_parts(tiles).items()}
    common = mean["heightmap"] + mean["variance"] + mean["class"]
    methods = {name: common + mean[name] for name in ("open3d", "sklearn") if name in mean}
    print(
        json.dumps(
            {
                "tiles": len(tiles.points),
                "points_per_tile": round(statistics.fmean(map(len, tiles.points))),
                "ours_ms": 1e3 * ours(tiles, 9) / len(tiles.points),
                "methods_ms": {**methods, "both": sum(methods.values()) - common * (len(methods) - 1)},
                "steps_ms": mean,
            }
        )
    )


if __name__ == "__main__":
    main()
