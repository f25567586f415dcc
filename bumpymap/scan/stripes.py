"""The filter method: Gabor filters detect stripes on the ground, and k-means++ on their number makes the classes.

Scan lines form stripes on the ground. On smooth ground they are straight; relief bends and breaks them, because a beam
hits a higher point nearer to the sensor. Their number depends on the sensor, its height and the distance, and so would
the class. Therefore synthetic lines are drawn in the same way for every sensor: over the sector's heightmap, one stripe
every ``wavelength_px`` rows, displaced outwards or inwards by one stripe for every ``metres_per_stripe`` of height.
Smooth ground shows ``pixels / wavelength_px`` of them, whatever the sensor.

The filters find the stripes that remain. Each of the 8 orientations responds with 1 to straight stripes in its own
direction and with 0 to no pattern. The largest response is used, so that long undulations, which only turn the
stripes, do not matter, while short bumps break them. Counted are the runs of pixels, along each column, with a response
of ``threshold`` or more.

Stripes tell the relief of the ground, not the objects on it. Where most points of a sector are not ground, its class is
1 at least; it is 2 where most of those stand in the vehicle's way: a wall, a car, a fence. Plants reach higher.
"""

import math
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from bumpymap.core import CLASSES, NOT_TRAVERSABLE, ClassedSectors, PolarSettings, SectorStack, UsageError, parse_json
from bumpymap.scan.sectors import OPEN_SHARE, with_places

_BLOCKED_SHARE = 0.45
"""Least share of obstacles among the points that are not ground, of a sector that is not open, for class 2 (chosen)."""
_OCTAVE = 3.0 * math.sqrt(math.log(2.0) / 2.0) / math.pi
"""Standard deviation of a Gabor filter of one octave at half height, in wavelengths."""
_AT_ONCE = 8
"""Heightmaps of one matrix product. A larger product is computed in threads, which wait for each other where the cores
are taken: all maps at once took 10 ms for seven scans on idle cores, and 30 to 200 ms on busy ones; these, 15 ms."""


@dataclass(frozen=True, slots=True)
class StripeFilter:
    """Settings of drawing and counting stripes."""

    wavelength_px: float = 3.0
    """Distance of stripes, and wavelength of the filters; as in the paper."""
    gamma: float = 0.5
    """Ratio of a filter's width across the stripes to that along them; as in the paper."""
    orientations: int = 8
    """Number of filters, in equal steps over half a turn; as in the paper."""
    metres_per_stripe: float = 0.25
    """Height that displaces the stripes by one. A relief of white noise breaks half of them at 0.21 times this, m."""
    threshold: float = 0.5
    """Smallest filter response that is a stripe; an unbroken one has 1."""


@dataclass(frozen=True, slots=True)
class StripeModel:
    """Stripe classes, the same for every scan."""

    filter: StripeFilter
    pixels: int
    """Rows and columns of the heightmaps."""
    centres: tuple[float, float, float]
    """Number of stripes at the centre of class 0, 1 and 2; decreasing."""
    scans: int
    """Number of scans that it was fitted to."""
    sectors: int
    """Number of traversable sectors in them."""
    seed: int
    """Seed of k-means++."""

    def require_pixels(self, settings: PolarSettings) -> None:
        """Raise UsageError if the classes were fitted on heightmaps of another size."""
        if settings.pixels != self.pixels:
            raise UsageError(
                f"the stripe classes were fitted on heightmaps of {self.pixels} pixels, and pixels is "
                f"{settings.pixels}. Leave out pixels"
            )


def count_stripes(heights: NDArray[np.float32], settings: StripeFilter | None = None) -> NDArray[np.float32]:
    """Draw stripes over heightmaps and count those that the relief does not break.

    ``heights`` (n, pixels, pixels): height above the plane of the sector, rows outwards, without holes, m. Returns
    (n,): mean number of stripes along a column: ``pixels / wavelength_px`` on even ground, towards 0 on rough ground.
    """
    settings = settings or StripeFilter()
    count, pixels = heights.shape[:2]
    line = np.arange(pixels, dtype=np.float32)[:, None] - pixels // 2
    turns = line / np.float32(settings.wavelength_px) + heights / np.float32(settings.metres_per_stripe)
    maps = np.zeros((-(-count // _AT_ONCE), 1, _AT_ONCE, pixels * pixels), np.float32)
    maps.reshape(-1, pixels, pixels)[:count] = np.cos(np.float32(2.0 * math.pi) * (turns - np.rint(turns)))
    responses = (maps @ gabor_bank(pixels, settings)).max(axis=1).reshape(-1, pixels, pixels)[:count]
    in_stripe = responses >= settings.threshold
    in_stripe[:, 1:] &= ~in_stripe[:, :-1]  # the first pixel of each run alone
    return np.asarray(in_stripe.sum(axis=(1, 2), dtype=np.float32) / np.float32(pixels))


@cache
def gabor_bank(pixels: int, settings: StripeFilter) -> NDArray[np.float32]:
    """Return the weights of an image's pixels in the filter responses, real parts.

    Returns (orientations, pixels^2, pixels^2): the weight of each pixel (rows) in the response at each pixel (columns).
    A filter that extends beyond the image is scaled so that unbroken stripes still give 1.
    """
    from skimage.filters import gabor_kernel  # slow to load

    across = _OCTAVE * settings.wavelength_px
    far = 2.0 * pixels / across  # standard deviations: the kernels reach over the image from every pixel, at any angle
    bank = np.empty((settings.orientations, pixels * pixels, pixels * pixels), np.float32)
    for number in range(settings.orientations):
        theta = math.pi * number / settings.orientations
        kernel = gabor_kernel(
            1.0 / settings.wavelength_px, theta, sigma_x=across, sigma_y=across / settings.gamma, n_stds=far
        )
        inner = tuple(slice(side // 2 - pixels + 1, side // 2 + pixels) for side in kernel.shape)
        near = sliding_window_view(kernel[inner], (pixels, pixels))[::-1, ::-1].reshape(pixels * pixels, -1)
        scale = (near.real**2 / np.abs(near)).sum(axis=1, keepdims=True)  # envelope times squared wave
        bank[number] = (near.real / scale).T
    return bank


def classify_filter(stack: SectorStack, model: StripeModel | None = None) -> ClassedSectors:
    """Assign to every traversable sector the class whose centre is nearest to its stripe count.

    Objects on the ground may raise it. ``model``: None: the included one. Raises UsageError: it was fitted on
    heightmaps of another size.
    """
    model = model or load_stripes()
    model.require_pixels(stack.settings)
    stripes = np.full(len(stack.zone), np.nan, np.float32)
    stripes[stack.traversable] = count_stripes(stack.heights[stack.traversable], model.filter)
    nearest = np.abs(stripes[:, None] - np.array(model.centres, np.float32)).argmin(axis=1).astype(np.uint8)
    standing = stack.count - stack.ground_count
    is_covered = stack.ground_count < OPEN_SHARE * stack.count
    is_blocked = is_covered & (stack.obstacle_count >= _BLOCKED_SHARE * standing)
    rougher = np.maximum(nearest, is_covered.astype(np.uint8) + is_blocked.astype(np.uint8))
    class_id = np.where(stack.traversable, rougher, np.uint8(NOT_TRAVERSABLE))
    # Between two centres a sector says part of each class, so that a small change of its stripes changes little.
    between, classes = np.interp(-stripes, -np.array(model.centres), np.arange(CLASSES)), np.arange(CLASSES)
    says = np.maximum(1.0 - np.abs(np.where(rougher > nearest, rougher, between)[:, None] - classes), 0.0)
    return with_places(stack, class_id, stripes, "filter", says)


@cache
def load_stripes() -> StripeModel:
    """Return the included classes, fitted to simulated scans of many sensors (``docs/models/stripes.py``)."""
    record = parse_json((files("bumpymap.scan") / "data" / "models" / "stripes.json").read_text(encoding="utf-8"))
    del record["format"]
    smooth, middle, rough = record.pop("centres")
    return StripeModel(StripeFilter(**record.pop("filter")), centres=(smooth, middle, rough), **record)
