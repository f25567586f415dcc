"""The paper's method: four terrain forms, distinguished by a small network, and the ride cost of each from a table.

A texture is a patch as ``PatchStack.relief_map`` shows it to the network and to the simulated vehicle: with its
least-squares plane removed, then min-max scaled. Scaled, level ground is the noise of its survey, which looks like
rubble: so the network also gets the relief and the noise in metres.

The texture of a tile must not depend on the other tiles of a stack. Patches therefore pass through the network in
batches of a fixed size, the last one padded, on one thread, and the graph has no operation across patches.

For each texture the calibration knows ``C_r`` at a ladder of z ranges. A tile's ``C_r`` under one texture is read off
that ladder (straight lines in log-log); the network's probabilities then weigh the four answers. What is predicted is
the whole distribution, a mixture of four log-normals, so an interval and the probability of the class come with it.
"""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    FAIL_SHARE,
    NO_CLASS,
    NORMAL_80,
    TEXTURES,
    BadInputError,
    CostMap,
    Floats,
    PatchStack,
    Reason,
    UsageError,
    check_network,
    metadata_of,
    parse_json,
    read_network,
    session,
    shipped_network,
)
from bumpymap.rating.calibration import Calibration
from bumpymap.rating.ride.correction import TAIL
from bumpymap.rating.vehicle_profile import with_floor

FEATURE_VERSION = 2
"""Version of the network's input (plane-removed, hole-filled, min-max scaled relief, and `measures_of`). If it changes,
train again."""
MEASURES = 3
"""Length of a row of `measures_of`."""


def normalise(patches: NDArray[np.floating]) -> NDArray[np.float32]:
    """Scale each patch (n, pixels, pixels) without NaN to [0, 1] by its own extremes, as the texture network takes it.

    Training and inference both use this function. A patch of constant height becomes zeros.
    """
    low = patches.min(axis=(1, 2), keepdims=True).astype(np.float64)  # extremes need no double precision
    span = patches.max(axis=(1, 2), keepdims=True) - low
    scaled: Floats = patches - low
    scaled /= np.where(span > 0, span, 1.0)
    return scaled.astype(np.float32)


def measures_of(
    relief_map: NDArray[np.floating], count: NDArray[np.integer], variance: NDArray[np.floating], rise: Floats
) -> NDArray[np.float32]:
    """Return what the network is given of a tile's metres beside its scaled patch, (n, 3).

    Logarithms of the relief over 0.1 m and of the standard error of the pixels' means over 0.01 m, and 1; the last two
    are 0 where too few pixels hold two points. ``relief_map``, ``count``, ``variance`` (n, pixels, pixels): as
    ``relief_map``, ``spread_count`` and ``spread_variance`` of a `PatchStack`; ``rise`` (n,): of the tile's plane over
    a pixel, m: points beside the middle of their pixel err by it. NaN counts as 0.
    """
    count = count.reshape(len(count), count.shape[-1] ** 2)
    variance = np.where(count > 0, variance.reshape(count.shape).astype(np.float64), 0.0)
    freedom = np.maximum(count - 1, 0).sum(axis=1)
    square = (count * variance * (count > 1)).sum(axis=1) / np.maximum(freedom, 1)
    share = (1.0 / np.maximum(count, 1) * (count > 0)).sum(axis=1) / np.maximum((count > 0).sum(axis=1), 1)
    known = freedom >= _LEAST_FREEDOM
    error = np.where(
        known, np.log(np.clip(np.sqrt((square + np.nan_to_num(rise) ** 2 / 12) * share), *_ERRORS) / 0.01), 0.0
    )
    relief = np.log(np.clip(np.ptp(relief_map, axis=(1, 2)), *_RELIEFS) / 0.1)
    return np.stack((relief, error, known), axis=1).astype(np.float32)


_LEAST_FREEDOM = 4
"""Points beyond one a pixel, that many at least, or the noise of a tile is not known."""
_RELIEFS, _ERRORS = (0.005, 10.0), (2e-4, 0.5)
"""Reliefs and standard errors, m, that the network has learned from; others count as the nearest."""


_NETWORK_BATCH = 16
"""Larger batches save 3 % per patch but lose more to padding: a block has about two hundred tiles."""
_FORMAT = "bumpymap-textures"
_INPUT, _MEASURES = "patches", "measures"
_KIND = "texture network"
_REMEDY = "Train one with: bumpymap train textures --out MODEL.onnx"


@dataclass(frozen=True, slots=True)
class TextureModel:
    """A texture network as plain data that can be sent to other processes."""

    content: bytes
    """Content of the ONNX file."""
    metadata: dict[str, str]
    """``metadata_props`` of the file: seed, command, accuracies."""
    tile_size: float
    """Side of the tiles it was trained for, m."""
    pixels: int
    """Pixels along a side."""

    @property
    def id(self) -> str:
        """Twelve hex digits of the SHA-256 of the file."""
        return hashlib.sha256(self.content).hexdigest()[:12]

    def require_grid(self, tile_size: float, pixels: int) -> None:
        """Raise UsageError if tiles to classify differ in size [m] or number of pixels from the network's."""
        if (tile_size, pixels) != (self.tile_size, self.pixels):
            raise UsageError(
                f"tiles are {tile_size:g} m with {pixels} pixels; the texture network {self.id} was trained for "
                f"{self.tile_size:g} m with {self.pixels}. Use `tile_size={self.tile_size:g}`, `pixels={self.pixels}`, "
                f"or train one: bumpymap train textures --set tile_size={tile_size:g} --set network.pixels={pixels} "
                "--out MODEL.onnx"
            )

    @classmethod
    def shipped(cls) -> "TextureModel":
        """Read the network that is included in bumpymap."""
        return cls._from_bytes(shipped_network("rating", "textures.onnx"), "the texture network in the package")

    @classmethod
    def load(cls, path: Path) -> "TextureModel":
        """Read a network written by ``bumpymap train``. Raises BadInputError if it is not one."""
        return cls._from_bytes(read_network(path, _KIND, _REMEDY), str(path))

    @classmethod
    def _from_bytes(cls, content: bytes, origin: str) -> "TextureModel":
        metadata = metadata_of(content, _FORMAT, origin, _KIND, _REMEDY)
        try:
            classes, version = tuple(parse_json(metadata["classes"])), int(metadata["feature_version"])
            tile_size, pixels = float(metadata["tile_size"]), int(metadata["pixels"])
        except (KeyError, ValueError, TypeError) as error:
            raise BadInputError(f"{origin} is a damaged texture network: {error!r}. {_REMEDY}") from error
        if (classes, version) != (TEXTURES, FEATURE_VERSION):
            raise BadInputError(
                f"{origin} has the classes {', '.join(map(str, classes))} and takes patches of version {version}; this "
                f"bumpymap needs {', '.join(TEXTURES)} and version {FEATURE_VERSION}. {_REMEDY}"
            )
        if pixels < 1:
            raise BadInputError(f"{origin} is a damaged texture network: its pixels are {pixels}. {_REMEDY}")
        inputs = {_INPUT: (_NETWORK_BATCH, 1, pixels, pixels), _MEASURES: (_NETWORK_BATCH, MEASURES, 1, 1)}
        check_network(content, inputs, len(TEXTURES), origin, _REMEDY)
        return cls(content, metadata, tile_size, pixels)


def classify(patches: PatchStack, model: TextureModel) -> NDArray[np.float32]:
    """Classify the texture of n tiles: (n, 4) probabilities, see `CostMap`; NaN where ``reason`` is not 0.

    Raises UsageError if the network was trained for tiles of another size or another number of pixels.
    """
    model.require_grid(patches.grid.tile_size, patches.grid.pixels)
    known = np.flatnonzero(patches.reason == Reason.OK)
    relief = patches.relief_map[known]
    probability = np.full((len(patches.reason), len(TEXTURES)), np.nan, np.float32)
    scaled = normalise(relief.reshape(len(relief), 1, model.pixels**2))  # min and max over one axis are 4 times faster
    rise = np.tan(np.radians(patches.slope[known])) * patches.grid.pixel_size
    measures = measures_of(relief, patches.spread_count[known], patches.spread_variance[known], rise)
    probability[known] = infer(model, scaled.reshape(relief.shape), measures)
    return probability


def infer(model: TextureModel, scaled: NDArray[np.float32], measures: NDArray[np.float32]) -> NDArray[np.float32]:
    """Run the network on scaled patches (n, pixels, pixels) and `measures_of` (n, 3); return probabilities (n, 4)."""
    network, count = session(model.content), len(scaled)
    more = (0, -count % _NETWORK_BATCH)
    inputs = {
        _INPUT: np.pad(scaled[:, None], (more, *[(0, 0)] * 3)),
        _MEASURES: np.pad(measures[:, :, None, None], (more, *[(0, 0)] * 3)),
    }
    batches = range(0, count, _NETWORK_BATCH)
    parts = [network.run(None, {name: v[at : at + _NETWORK_BATCH] for name, v in inputs.items()})[0] for at in batches]
    return np.concatenate((np.empty((0, len(TEXTURES)), np.float32), *parts))[:count]


_MIN_LOG_SD = 0.05
"""Least standard deviation of ln C_r between patches of a cell of the table. Chosen: the patches are few."""
_ROUNDS, _CLOSE = 100, 1e-10
"""Newton's steps at most, and how close they come; most need six."""
_TINY = 1e-9
"""Relief [m] and density that stand for 0 in a logarithm or a division."""
_LEAST_COVERAGE = 0.7
"""Compat: with less than this share of the pixels filled a tile is class 3."""

PAPER_TABLE: dict[str, tuple[tuple[float, int], ...]] = {
    "flat": ((2.0, 0), (np.inf, 3)),
    "low_noise": ((0.5, 0), (2.5, 1), (np.inf, 3)),
    "noise_sin": ((0.5, 0), (1.0, 1), (2.5, 2), (np.inf, 3)),
    "high_noise": ((1.5, 1), (2.0, 2), (np.inf, 3)),
}
"""The paper's table: texture -> (raw z range below [m], class)."""


def rate(patches: PatchStack, probability: NDArray[np.float32], calibration: Calibration) -> CostMap:
    """Rate n tiles by the probability of their textures, of `classify`, and relief (``rating = "table"``).

    Raises UsageError if the calibration was made for tiles of another size or another number of pixels.
    """
    calibration.require_grid(patches.grid.tile_size, patches.grid.pixels)
    known = patches.reason == Reason.OK
    chance = probability[known].astype(np.float64)
    log_mean, log_sd, fails = _read_tables(patches.relief[known], calibration)
    c_r, p_fail = (chance * np.exp(log_mean)).sum(axis=1), np.minimum((chance * fails).sum(axis=1), 1.0)
    too_steep = patches.slope[known] > calibration.profile.slope_limit_deg
    mixture = chance, log_mean - 0.5 * log_sd**2, log_sd  # the tables hold the logarithm of the mean
    low, high = (
        np.exp(_quantile(mixture, share, normal)) for share, normal in ((TAIL, -NORMAL_80), (1 - TAIL, NORMAL_80))
    )
    edges = np.concatenate(([-np.inf], np.log(calibration.class_limits), [np.inf]))
    failing = too_steep | (p_fail >= FAIL_SHARE)
    rank = np.where(failing, len(edges) - 2, np.searchsorted(calibration.class_limits, c_r, side="right"))
    sure = np.where(
        failing,
        np.where(too_steep, 1.0, p_fail),
        _share_below(mixture, edges[rank + 1]) - _share_below(mixture, edges[rank]),
    )
    interval = (
        with_floor(values, calibration.map_floor) for values in (c_r, np.minimum(low, c_r), np.maximum(high, c_r))
    )
    c_r, low, high, p_fail, sure = (
        _spread(known, values) for values in (*interval, p_fail, sure * patches.coverage[known])
    )
    class_id = np.full(len(known), NO_CLASS, np.uint8)
    class_id[known] = rank
    return CostMap(patches, class_id, c_r, low, high, p_fail, sure, probability)


Mixture = tuple[Floats, Floats, Floats]
"""Mixtures of log-normals, one for each of n tiles: chance, mean and standard deviation of ln C_r, (n, parts) each."""


def _share_below(mixture: Mixture, log_c: Floats) -> Floats:
    """Return the probability, (n,), that C_r is below exp(log_c)."""
    from scipy.special import ndtr

    chance, log_mean, log_sd = mixture
    return np.asarray((chance * ndtr((log_c[:, None] - log_mean) / log_sd)).sum(axis=1))


def _quantile(mixture: Mixture, share: float, normal: float) -> Floats:
    """Find the ln C_r, (n,), with a share of each mixture below it; ``normal`` is the standard normal's quantile.

    Newton's steps inside a bracket, halved where a step leaves it. A mixture's quantile lies between those of its
    parts; the margin allows for probabilities that sum to 1 but for their rounding.
    """
    chance, log_mean, log_sd = mixture
    own = log_mean + normal * log_sd
    low = np.where(chance > 0, own - 1e-2 * log_sd, np.inf).min(axis=1)
    high = np.where(chance > 0, own + 1e-2 * log_sd, -np.inf).max(axis=1)
    at, found = (chance * own).sum(axis=1), np.zeros(len(low), np.bool_)
    for _ in range(_ROUNDS):
        excess = _share_below(mixture, at) - share
        low, high = np.where(excess < 0, at, low), np.where(excess < 0, high, at)
        z = (at[:, None] - log_mean) / log_sd
        density = (chance * np.exp(-0.5 * z * z) / log_sd).sum(axis=1) / np.sqrt(2 * np.pi)
        step = at - excess / np.maximum(density, _TINY)
        after = np.where((step > low) & (step < high), step, 0.5 * (low + high))
        # A tile that has been found stays, so that its bits do not depend on the others.
        found, at = found | (np.abs(after - at) < _CLOSE), np.where(found, at, after)
        if found.all():
            break
    return np.asarray(at)


def rate_as_paper(patches: PatchStack, probability: NDArray[np.float32], calibration: Calibration) -> CostMap:
    """Rate tiles by the paper's rules (``compat = "paper"``): raw z range of the points, its table, its 30 % rule.

    Every tile with points gets a class; those that we would call unknown are class 3. ``c_r`` is the calibration's
    mean of the class, the interval is the class's own, ``confidence`` the probability of the winning texture.
    """
    calibration.require_grid(patches.grid.tile_size, patches.grid.pixels)
    chance = np.nan_to_num(probability.astype(np.float64))
    raw_range = patches.z_max - patches.z_min
    by_texture = np.stack(
        [
            np.array([class_id for _, class_id in rule])[np.digitize(raw_range, [limit for limit, _ in rule[:-1]])]
            for rule in PAPER_TABLE.values()
        ],
        axis=1,
    )
    class_id = np.take_along_axis(by_texture, chance.argmax(axis=1)[:, None], axis=1)[:, 0]
    judged = (patches.reason == Reason.OK) & (patches.coverage >= _LEAST_COVERAGE)
    class_id = np.where(judged, class_id, 3)
    measured = patches.reason != Reason.NO_GROUND
    edges = with_floor(np.array([0.0, *calibration.class_limits, np.inf]), calibration.map_floor)
    p_fail = np.where(patches.slope > calibration.profile.slope_limit_deg, 1.0, np.nan)
    high = np.where(class_id == len(edges) - 2, np.nan, edges[class_id + 1])
    out = np.full(len(measured), NO_CLASS, np.uint8)
    out[measured] = class_id[measured]
    return CostMap(
        patches=replace(patches, reason=np.where(measured, Reason.OK, patches.reason).astype(np.uint8)),
        class_id=out,
        c_r=_spread(measured, with_floor(np.array(calibration.class_c_r), calibration.map_floor)[class_id[measured]]),
        c_r_low=_spread(measured, edges[class_id[measured]]),
        c_r_high=_spread(measured, high[measured]),
        p_fail=_spread(measured, p_fail[measured]),
        confidence=_spread(judged, chance.max(axis=1)[judged]),
        probability=probability,
    )


def _read_tables(relief: NDArray[np.floating], calibration: Calibration) -> Floats:
    """Read ln C_r, its standard deviation and p_fail of every texture at reliefs (n,) [m], (3, n, textures).

    Straight lines between the rungs of ln z_range. Below the ladder, and above the last rung on which most drives
    arrive, C_r is proportional to the relief: a small vehicle motion is linear in the ground's amplitude, and the few
    drives that arrive on higher ground are those that it shakes least. The spread is that of the last rung with one.
    """
    p_fail, c_r, log_sd = (
        np.array(table, float) for table in (calibration.p_fail, calibration.c_r, calibration.c_r_log_sd)
    )
    log_sd[:, 0] = np.where(np.isnan(log_sd[:, 0]), _MIN_LOG_SD, log_sd[:, 0])
    rungs, x = np.log(np.array(calibration.z_range)), np.log(np.maximum(relief.astype(np.float64), _TINY))
    arrives = _last(~np.isnan(c_r) & (p_fail < FAIL_SHARE))
    log_c_r = np.log(np.take_along_axis(c_r, arrives, axis=1)) + rungs - rungs[arrives]
    log_sd = np.maximum(np.take_along_axis(log_sd, _last(~np.isnan(log_sd)), axis=1), _MIN_LOG_SD)
    tables = (log_c_r, log_sd, p_fail)
    read = np.array([[np.interp(x, rungs, line) for line in table] for table in tables]).transpose(0, 2, 1)
    read[0] += (x - np.clip(x, rungs[0], rungs[-1]))[:, None]
    return read


def _last(known: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return, for each place of rows (n, rungs), the last known one up to it; 0 before the first."""
    return np.maximum.accumulate(np.where(known, np.arange(known.shape[1]), 0), axis=1)


def _spread(known: NDArray[np.bool_], values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Put values of the known tiles into an array over all tiles; NaN elsewhere."""
    out = np.full(len(known), np.nan, np.float32)
    out[known] = values
    return out
