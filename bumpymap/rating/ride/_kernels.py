"""Compiled loops of the ride model: noise of a heightmap, what of it is ground, wheels on that ground.

Nothing here allocates: scratch arrays come from the caller. Sums run in one fixed order, so the same patch gives the
same bits wherever it stands among others.
"""

import math

import numpy as np
from numpy.typing import NDArray

from bumpytiles import entry, inner

__all__ = ["GROUP", "denoise_patches", "normal_shares", "ride_patches"]

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]

GROUP = 8
"""Patches that ride side by side: their envelopes lie together, so a processor adds for all of them at once."""
_LEAST_FREEDOM = 10.0
"""Points beyond one a pixel, that many at least, or the noise of a tile cannot be told."""
_SIGNIFICANT = 9.0
"""A coefficient whose square is that many times its noise is ground, whatever its neighbours say (p = 0.003)."""
_ROUNDS = 12
_MOST_NOISE = 0.01
"""Variance, m^2. Points that scatter by more than 0.1 m inside a pixel are leaves over ground, or blocks: a scanner is
better than that. What is beyond stays in the ground."""
_FILLED = 0.4
"""Noise variance of a pixel that was filled, over that of one that was seen: a mean of some neighbours."""
_TINY = 1e-12


@inner
def _filter_point(values: Floats, weights: Floats, start: int, end: int) -> None:
    root = start
    while 2 * root + 1 <= end:
        child = 2 * root + 1
        if child < end and values[child] < values[child + 1]:
            child += 1
        if values[root] >= values[child]:
            return
        values[root], values[child] = values[child], values[root]
        weights[root], weights[child] = weights[child], weights[root]
        root = child


@inner
def _sort_together(values: Floats, weights: Floats, n: int) -> None:
    """Heap sort of the first n values; the weights go with them."""
    for start in range(n // 2 - 1, -1, -1):
        _filter_point(values, weights, start, n - 1)
    for end in range(n - 1, 0, -1):
        values[0], values[end] = values[end], values[0]
        weights[0], weights[end] = weights[end], weights[0]
        _filter_point(values, weights, 0, end - 1)


@inner
def _point_noise(count: Integers, variance: Singles, values: Floats, weights: Floats) -> float:
    """Noise variance of a single point, m^2; NaN where too few pixels hold two points.

    The median of the pixels' own variances, each as often as it has degrees of freedom: an edge inside some pixels
    does not move it. A median of chi-square numbers is too low by (1 - 2 / (9 k))^3.
    """
    size = count.shape[0]
    n = 0
    total = squares = 0.0
    for r in range(size):
        for c in range(size):
            if count[r, c] > 1:
                weight = np.float64(count[r, c] - 1)
                values[n] = variance[r, c] * (weight + 1.0) / weight
                weights[n] = weight
                total += weight
                squares += weight * weight
                n += 1
    if total < _LEAST_FREEDOM:
        return np.nan
    _sort_together(values, weights, n)
    below = 0.0
    median = values[n - 1]
    for i in range(n):
        below += weights[i]
        if below >= 0.5 * total:
            median = values[i]
            break
    return min(median / (1.0 - 2.0 * total / (9.0 * squares)) ** 3, _MOST_NOISE)


@inner
def _pixel_noise(count: Integers, point: float) -> float:
    """Mean noise variance of the pixels' heights, m^2."""
    size = count.shape[0]
    seen, total = 0, 0.0
    for r in range(size):
        for c in range(size):
            if count[r, c] > 0:
                seen += 1
                total += point / count[r, c]
    if seen == 0:
        return np.nan
    filled = size * size - seen
    return (total + filled * _FILLED * total / seen) / (size * size)


@inner
def _turn(basis: Floats, patch: Floats, middle: Floats, out: Floats, forward: bool) -> None:
    """Cosine transform of a patch, or back."""
    size = basis.shape[0]
    for i in range(size):
        for j in range(size):
            total = 0.0
            for k in range(size):
                total += (basis[i, k] if forward else basis[k, i]) * patch[k, j]
            middle[i, j] = total
    for i in range(size):
        for j in range(size):
            total = 0.0
            for k in range(size):
                total += middle[i, k] * (basis[j, k] if forward else basis[k, j])
            out[i, j] = total


@inner
def _fit_strength(bands: Floats, noise: float, shape: Floats) -> float:
    """Strength A of a ground spectrum A * shape beside white noise, by weighted steps (Whittle's likelihood)."""
    power = shapes = 0.0
    for b in range(bands.shape[1]):
        power += bands[1, b] * (bands[0, b] - noise)
        shapes += bands[1, b] * shape[b]
    strength = max(power, 0.01 * noise) / shapes
    for _ in range(_ROUNDS):
        top = bottom = 0.0
        for b in range(bands.shape[1]):
            share = shape[b] / (strength * shape[b] + noise)
            weight = bands[1, b] * share * share
            top += weight * (bands[0, b] - noise) / shape[b]
            bottom += weight
        strength = max(top / bottom, _TINY)
    return strength


@inner
def _fit_spectrum(bands: Floats, noise: float, shapes: Floats, ground: Floats) -> None:
    """Fill ``ground`` with the likeliest power of each band, m^2."""
    best = np.inf
    for s in range(shapes.shape[0]):
        strength = _fit_strength(bands, noise, shapes[s])
        score = 0.0
        for b in range(bands.shape[1]):
            power = strength * shapes[s, b] + noise
            score += bands[1, b] * (bands[0, b] / power + math.log(power))
        if score < best:
            best = score
            for b in range(bands.shape[1]):
                ground[b] = strength * shapes[s, b]


@inner
def _band_powers(waves: Floats, band: Integers, bands: Floats) -> None:
    """Mean square of the coefficients of each band, and their number."""
    for b in range(bands.shape[1]):
        bands[0, b] = bands[1, b] = 0.0
    size = waves.shape[0]
    for i in range(size):
        for j in range(size):
            b = band[i, j]
            if b >= 0:
                bands[0, b] += waves[i, j] * waves[i, j]
                bands[1, b] += 1.0
    for b in range(bands.shape[1]):
        bands[0, b] /= bands[1, b]


@inner
def _take_noise_off(waves: Floats, band: Integers, ground: Floats, noise: float) -> None:
    """Shrink each coefficient to the power that is ground's."""
    size = waves.shape[0]
    for i in range(size):
        for j in range(size):
            b = band[i, j]
            if b < 0:
                waves[i, j] = 0.0
                continue
            power = waves[i, j] * waves[i, j]
            stands_out = power > _SIGNIFICANT * noise
            kept = (power - noise) / power if stands_out else ground[b] / (ground[b] + noise)
            waves[i, j] *= math.sqrt(kept)


@entry("?:1 f4:3 i4:3 f4:3 f8:2 i4:2 f8:2 f8:2 f8:1 f8:2 f8:3 f4:3 f8:2")
def denoise_patches(
    known: NDArray[np.bool_],
    relief: Singles,
    count: Integers,
    variance: Singles,
    basis: Floats,
    band: Integers,
    shapes: Floats,
    bands: Floats,
    ground: Floats,
    sorted_spreads: Floats,
    work: NDArray[np.float64],
    clean: Singles,
    noise: Floats,
) -> None:
    """Take the scan's noise out of patches; see ``bumpymap.rating.ride.noise`` for the model.

    Parameters
    ----------
    known : (tiles,) bool
        Others keep what the results hold.
    relief : (tiles, pixels, pixels) float32
        Relief maps: plane-removed, holes filled, m.
    count, variance : (tiles, pixels, pixels) int32, float32
        Points of each pixel, and the variance of their heights above the tile's plane, m^2.
    basis : (pixels, pixels) float64
        Orthonormal cosines.
    band : (pixels, pixels) int32
        Band of each coefficient; -1 for the mean.
    shapes : (spectra, bands) float64
        Power of each band for unit strength.
    bands, ground, sorted_spreads, work
        Scratch: (2, bands), (bands,), (2, pixels^2), (3, pixels, pixels).
    clean : (tiles, pixels, pixels) float32
        Filled: relief without noise, m.
    noise : (2, tiles) float64
        Filled: standard deviation of a point [m] and of a pixel's height [m].
    """
    size = basis.shape[0]
    patch, middle, waves = work[0], work[1], work[2]
    for t in range(len(known)):
        if not known[t]:
            continue
        for i in range(size):
            for j in range(size):
                clean[t, i, j] = relief[t, i, j]
                patch[i, j] = relief[t, i, j]
        point = _point_noise(count[t], variance[t], sorted_spreads[0], sorted_spreads[1])
        pixel = _pixel_noise(count[t], point)
        noise[0, t], noise[1, t] = math.sqrt(point), math.sqrt(pixel)
        if not pixel > _TINY:
            continue
        _turn(basis, patch, middle, waves, True)
        _band_powers(waves, band, bands)
        _fit_spectrum(bands, pixel, shapes, ground)
        _take_noise_off(waves, band, ground, pixel)
        _turn(basis, waves, middle, patch, False)
        for i in range(size):
            for j in range(size):
                clean[t, i, j] = patch[i, j]


@inner
def _lay_nodes(patch: Singles, fine: int, wide: Singles, margin: int) -> None:
    """Bilinear heights at the nodes of a patch, with a mirrored margin around them."""
    pixels = patch.shape[0]
    nodes = pixels * fine + 1
    period = 2 * (nodes - 1)
    for r in range(wide.shape[0]):
        row = (r - margin) % period
        row = min(row, period - row)
        y = row / fine - 0.5
        j = min(max(math.floor(y), 0), pixels - 2)
        up = np.float32(min(max(y - j, 0.0), 1.0))
        for c in range(wide.shape[1]):
            col = (c - margin) % period
            col = min(col, period - col)
            x = col / fine - 0.5
            i = min(max(math.floor(x), 0), pixels - 2)
            right = np.float32(min(max(x - i, 0.0), 1.0))
            north = patch[j, i] + (patch[j, i + 1] - patch[j, i]) * right
            south = patch[j + 1, i] + (patch[j + 1, i + 1] - patch[j + 1, i]) * right
            wide[r, c] = north + (south - north) * up


@inner
def _roll_wheel(
    wide: Singles, margin: int, rows: Integers, cols: Integers, rise: Singles, top: Singles, out: Singles, lane: int
) -> None:  # fmt: skip
    """Height of the lowest point of a wheel that touches the ground, at every node, into a lane of ``out``."""
    nodes = top.shape[0]
    for r in range(nodes):
        line = top[r]
        for c in range(nodes):
            line[c] = np.float32(-3e38)
        for o in range(len(rows)):
            first = margin + cols[o]
            ground = wide[r + margin + rows[o], first : first + nodes]
            lift = rise[o]
            for c in range(nodes):
                line[c] = max(line[c], ground[c] + lift)
        for c in range(nodes):
            out[r * nodes + c, lane] = line[c]


@inner
def _pitch_sums(starts: Integers, node: Integers, weight: Singles, envelope: Singles, sums: Floats) -> None:
    """Sum the size and the square of every sample's pitch change, for a group of patches."""
    for lane in range(GROUP):
        sums[0, lane] = sums[1, lane] = 0.0
    for s in range(len(starts) - 1):
        a = b = c = d = e = f = g = h = np.float32(0.0)
        for k in range(starts[s], starts[s + 1]):
            w, at = weight[k], envelope[node[k]]
            a += w * at[0]
            b += w * at[1]
            c += w * at[2]
            d += w * at[3]
            e += w * at[4]
            f += w * at[5]
            g += w * at[6]
            h += w * at[7]
        for lane, value in enumerate((a, b, c, d, e, f, g, h)):
            size = np.float64(abs(value))
            sums[0, lane] += size
            sums[1, lane] += size * size


@inner
def _read(node: Integers, weight: Singles, values: Singles, lane: int) -> float:
    total = 0.0
    for k in range(4):
        total += weight[k] * values[node[k], lane]
    return total


@inner
def _pose_numbers(
    wheel_node: Integers,
    wheel_weight: Singles,
    belly_node: Integers,
    belly_weight: Singles,
    geometry: Floats,
    envelope: Singles,
    bare: Singles,
    lane: int,
    out: Floats,
) -> None:
    """Root mean squares of pitch, roll and twist [rad], and how far the ground reaches to the belly (1: it touches)."""
    wheelbase, track, half, clearance = geometry[0], geometry[1], geometry[2], geometry[3]
    pitches = rolls = twists = 0.0
    strike = 0.0
    poses = wheel_node.shape[0]
    for p in range(poses):
        fl = _read(wheel_node[p, 0], wheel_weight[p, 0], envelope, lane)
        fr = _read(wheel_node[p, 1], wheel_weight[p, 1], envelope, lane)
        rl = _read(wheel_node[p, 2], wheel_weight[p, 2], envelope, lane)
        rr = _read(wheel_node[p, 3], wheel_weight[p, 3], envelope, lane)
        pitch = (fl + fr - rl - rr) / (2.0 * wheelbase)
        roll = (fl - fr + rl - rr) / (2.0 * track)
        twist = (fl - fr - rl + rr) / (2.0 * wheelbase)
        pitches += pitch * pitch
        rolls += roll * roll
        twists += twist * twist
        level = 0.25 * (fl + fr + rl + rr)
        for place in range(3):
            ground = _read(belly_node[p, place], belly_weight[p, place], bare, lane)
            strike = max(strike, (ground - level - (1 - place) * half * pitch) / clearance)
    out[2], out[3], out[4] = math.sqrt(pitches / poses), math.sqrt(rolls / poses), math.sqrt(twists / poses)
    out[5] = strike


@entry("?:1 f4:3 i8 i4:1 i4:1 f4:1 i4:1 i4:1 f4:1 i4:3 f4:3 i4:3 f4:3 f8:1 f4:2 f4:2 f4:2 f4:2 i8:1 f8:2 f8:2")
def ride_patches(
    known: NDArray[np.bool_],
    patches: Singles,
    fine: int,
    wheel_row: Integers,
    wheel_col: Integers,
    wheel_rise: Singles,
    starts: Integers,
    node: Integers,
    weight: Singles,
    wheel_node: Integers,
    wheel_weight: Singles,
    belly_node: Integers,
    belly_weight: Singles,
    geometry: Floats,
    wide: Singles,
    top: Singles,
    envelope: Singles,
    bare: Singles,
    members: NDArray[np.int64],
    sums: Floats,
    rides: Floats,
) -> None:
    """Roll a vehicle over patches.

    Parameters
    ----------
    known : (tiles,) bool
        Others keep what the results hold.
    patches : (tiles, pixels, pixels) float32
        Plane-removed relief without holes, m.
    fine, wheel_row, wheel_col, wheel_rise, starts, node, weight, wheel_node, wheel_weight, belly_node, belly_weight
        Of the `RideOperator`.
    geometry : (4,) float64
        Wheelbase, track, half the belly's length, clearance, m.
    wide, top, envelope, bare, members, sums
        Scratch: (nodes + 2 margin,) twice, (nodes, nodes), (nodes^2, ``GROUP``) twice, (``GROUP``,), (2, ``GROUP``).
    rides : (tiles, 6) float64
        Filled: mean and root mean square of the pitch change [rad/m]; root mean square of pitch, roll and twist [rad];
        reach of the ground towards the belly (1: it touches).
    """
    nodes, margin = top.shape[0], (wide.shape[0] - top.shape[0]) // 2
    tiles, samples = len(known), len(starts) - 1
    t = 0
    while t < tiles:
        held = 0
        while t < tiles and held < GROUP:
            if known[t]:
                _lay_nodes(patches[t], fine, wide, margin)
                _roll_wheel(wide, margin, wheel_row, wheel_col, wheel_rise, top, envelope, held)
                for r in range(nodes):
                    for c in range(nodes):
                        bare[r * nodes + c, held] = wide[r + margin, c + margin]
                members[held] = t
                held += 1
            t += 1
        if held == 0:
            continue
        _pitch_sums(starts, node, weight, envelope, sums)
        for lane in range(held):
            ride = rides[members[lane]]
            ride[0] = sums[0, lane] / samples
            ride[1] = math.sqrt(sums[1, lane] / samples)
            _pose_numbers(
                wheel_node, wheel_weight, belly_node, belly_weight, geometry, envelope, bare, lane, ride
            )  # fmt: skip


@entry("f8:1 f8:1")
def normal_shares(z: Floats, share: Floats) -> None:
    """Fill the share of the standard normal distribution below each z, both (n,)."""
    for i in range(len(z)):
        share[i] = 0.5 * math.erfc(-z[i] / math.sqrt(2.0))
