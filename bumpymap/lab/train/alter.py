"""Alter patches as a survey would: noise, holes, blur, brightness, rotation.

Each function takes patches scaled to [0, 1] and one strength per patch, and works on all patches at once. ``alter``
runs them in the order in which a survey does: the ground lies at some angle, the sensor blurs and adds noise, pixels
stay empty and are filled, the plane is taken off, the rest is scaled.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.rating import normalise, remove_plane

__all__ = [
    "ALL",
    "KINDS",
    "LIGHT",
    "NONE",
    "Alterations",
    "add_noise",
    "alter",
    "blur",
    "brighten",
    "fill_holes",
    "punch_holes",
    "rotate",
]

_Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Alterations:
    """How strong alterations may become; each patch draws its own strengths from 0 to these. Zero switches one off."""

    brightness: float = 0.3
    """Heights h become ``gain * h**exp(b) + offset``, b up to this either way. Gain and offset are those of survey
    units; scaling takes them out again, so b is what the network feels."""
    rotation: float = 1.0
    """Share of a full turn, any angle; corners are filled by mirroring. Patches may be flipped too."""
    blur: float = 0.7
    """Standard deviation of a Gaussian, px."""
    noise: float = 0.05
    """Standard deviation of white noise, share of the z range."""
    holes: float = 0.4
    """Share of the pixels that are emptied one by one; a round hole of up to 2.5 px radius comes on top."""
    chance: float = 1.0
    """Probability that a patch undergoes an alteration, each on its own."""

    def only(self, name: str) -> "Alterations":
        """Return a copy with every alteration but one switched off."""
        return replace(NONE, **{name: getattr(self, name)})


KINDS = ("brightness", "rotation", "blur", "noise", "holes")
ALL = Alterations()
"""Every alteration to every patch: what networks are judged by."""
LIGHT = Alterations(chance=0.5)
"""Some alterations to most patches; networks learn from a few such patches too."""
NONE = Alterations(0.0, 0.0, 0.0, 0.0, 0.0)


def alter(patches: NDArray[np.float32], settings: Alterations, rng: np.random.Generator) -> NDArray[np.float32]:
    """Alter each patch in its own way, then prepare it as a survey's patch is prepared.

    Parameters
    ----------
    patches : array (n, pixels, pixels) float32
        Scaled to [0, 1].
    settings : Alterations
        Upper ends of the strengths.
    rng : numpy Generator
        The same state gives the same bits; every alteration draws its numbers even where it is off, so that
        switching one off leaves the others as they are.

    Returns
    -------
    array (n, pixels, pixels) float32
        Plane-removed, scaled to [0, 1].
    """
    count = len(patches)
    drawn, happens = rng.uniform(size=(2, len(KINDS), count))
    strength = {
        kind: getattr(settings, kind) * drawn[k] * (happens[k] < settings.chance) for k, kind in enumerate(KINDS)
    }
    heights = patches.astype(np.float64)
    flip = (rng.uniform(size=count) < 0.5) & (settings.rotation > 0)
    heights = rotate(np.where(flip[:, None, None], heights[:, :, ::-1], heights), 2 * np.pi * strength["rotation"])
    heights = brighten(heights, strength["brightness"], rng)
    heights = blur(heights, strength["blur"])
    heights = add_noise(heights, strength["noise"], rng)
    heights = fill_holes(punch_holes(heights, strength["holes"], 2.5 * (strength["holes"] > 0), rng))
    return normalise(remove_plane(heights))


def rotate(patches: _Floats, angle: _Floats) -> _Floats:
    """Turn each patch about its centre by ``angle`` (n,) rad: bilinear, half-sample mirroring beyond the border."""
    count, pixels, _ = patches.shape
    axis = np.arange(pixels) - (pixels - 1) / 2
    cos, sin = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    row = _mirror(cos * axis[:, None] + sin * axis[None, :] + (pixels - 1) / 2, pixels)
    col = _mirror(cos * axis[None, :] - sin * axis[:, None] + (pixels - 1) / 2, pixels)
    r, c = np.minimum(row.astype(np.int64), pixels - 2), np.minimum(col.astype(np.int64), pixels - 2)
    down, right = row - r, col - c
    which = np.arange(count)[:, None, None]
    upper = patches[which, r, c] * (1 - right) + patches[which, r, c + 1] * right
    lower = patches[which, r + 1, c] * (1 - right) + patches[which, r + 1, c + 1] * right
    turned: _Floats = upper * (1 - down) + lower * down
    return turned


def _mirror(position: _Floats, pixels: int) -> _Floats:
    """Fold positions [px] into 0 .. pixels - 1 at the outer edges of the first and the last pixel."""
    folded = np.mod(position + 0.5, 2 * pixels)
    return np.clip(np.minimum(folded, 2 * pixels - folded) - 0.5, 0, pixels - 1)


def brighten(patches: _Floats, strength: _Floats, rng: np.random.Generator) -> _Floats:
    """Change gain, offset and, by a power of up to ``exp(strength)`` either way, the balance of high and low ground."""
    sign = rng.choice([-1.0, 1.0], len(patches))
    gain, offset = rng.uniform(0.5, 2.0, (2, len(patches), 1, 1))
    power = np.exp(sign * strength)[:, None, None]
    changed: _Floats = gain * np.clip(patches, 0.0, 1.0) ** power + offset
    return normalise(changed).astype(np.float64)


def blur(patches: _Floats, sigma: _Floats) -> _Floats:
    """Blur each patch by its own Gaussian of ``sigma`` (n,) px; the weights are renormalised at the border."""
    axis = np.arange(patches.shape[-1])
    distance = axis[None, :] - axis[:, None]
    kernel = np.exp(-0.5 * (distance / np.maximum(sigma, 1e-3)[:, None, None]) ** 2)
    kernel /= kernel.sum(axis=2, keepdims=True)
    blurred: _Floats = kernel @ patches @ kernel.transpose(0, 2, 1)
    return blurred


def add_noise(patches: _Floats, deviation: _Floats, rng: np.random.Generator) -> _Floats:
    """Add white noise; ``deviation`` (n,) is a share of the patch's own range."""
    noisy: _Floats = patches + (deviation * np.ptp(patches, axis=(1, 2)))[:, None, None] * rng.standard_normal(
        patches.shape
    )
    return noisy


def punch_holes(patches: _Floats, share: _Floats, radius: _Floats, rng: np.random.Generator) -> _Floats:
    """Empty (NaN) a ``share`` (n,) of the pixels one by one, and a round hole of up to ``radius`` (n,) px."""
    count, pixels, _ = patches.shape
    empty = rng.uniform(size=patches.shape) < share[:, None, None]
    centre = rng.uniform(0, pixels - 1, (2, count, 1, 1))
    size = rng.uniform(0, 1, (count, 1, 1)) * radius[:, None, None]
    axis = np.arange(pixels)
    empty |= (axis[:, None] - centre[0]) ** 2 + (axis[None, :] - centre[1]) ** 2 < size**2
    holed: _Floats = np.where(empty, np.nan, patches)
    return holed


def fill_holes(patches: _Floats) -> _Floats:
    """Fill NaN with the mean of the known ones among 8 neighbours, ring by ring: the rule of the features.

    A patch must hold at least one known pixel.
    """
    filled: _Floats = patches.copy()
    pixels = patches.shape[-1]
    for _ in range(pixels):
        empty = np.isnan(filled)
        if not empty.any():
            break
        rows = np.flatnonzero(empty.any(axis=(1, 2)))
        part, hole = filled[rows], empty[rows]
        known = np.pad(~hole, ((0, 0), (1, 1), (1, 1))).astype(np.float64)
        value = np.pad(np.where(hole, 0.0, part), ((0, 0), (1, 1), (1, 1)))
        total, number = np.zeros_like(part), np.zeros_like(part)
        for down in range(3):
            for right in range(3):
                window = (slice(None), slice(down, down + pixels), slice(right, right + pixels))
                total += value[window]
                number += known[window]
        reach = hole & (number > 0)
        part[reach] = total[reach] / number[reach]
        filled[rows] = part
    return filled
