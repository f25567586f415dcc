"""The colours of values in every layer, style, picture and page: one table each; ride cost has a continuous scale."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CANOPY, CLASS_NAMES, FREE, NO_CLASS, OBSTACLE, Barred, Reason

CLASS_COLOURS: dict[int, tuple[int, int, int, int]] = {
    0: (132, 199, 214, 255),
    1: (166, 136, 40, 255),
    2: (172, 66, 36, 255),
    3: (112, 8, 42, 255),
    NO_CLASS: (0, 0, 0, 0),
}
"""Red, green, blue, alpha of each class, from cool and faint (smooth) to warm and strong (very rough). Neighbours
differ by CIEDE2000 of 12 and more to all readers: with deuteranopia, with protanopia, and in grey too."""
CLOSED_COLOUR = (130, 128, 136, 255)
"""Of ground that cannot be crossed, whatever bars it, on maps of the ride."""
ISLAND_SHARE = 0.4
"""Share of its colour that an island keeps, mixed with ``MID_GREY``: chosen."""
MID_GREY = 128
"""Brightness that photo and relief are levelled to: light that leaves the colours of the map as they are."""


def on_islands(colours: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return colours, (..., 3) from 0 to 255, as islands have them: mixed with ``MID_GREY``."""
    return np.asarray(ISLAND_SHARE * colours + (1 - ISLAND_SHARE) * MID_GREY, np.float64)


BARRED_COLOURS: dict[int, tuple[int, int, int, int]] = {
    Barred.NO: (166, 217, 106, 255),
    Barred.UNKNOWN: (232, 232, 233, 255),
    Barred.OBSTACLE: (84, 48, 5, 255),
    Barred.SLOPE: (63, 59, 116, 255),
    Barred.FAILS: (179, 34, 75, 255),
    Barred.STEP: (193, 127, 0, 255),
    Barred.SPLIT: (80, 229, 255, 255),
    Barred.LITTLE_SEEN: (165, 75, 240, 255),
    NO_CLASS: (0, 0, 0, 0),
}
"""Red, green, blue, alpha of each `Barred`: passable tiles green, the others by what bars them. Colour-blind readers
distinguish any two."""
UNKNOWN_COLOUR = BARRED_COLOURS[Barred.UNKNOWN]
"""Of ground that is not known or not compared, in GIS, pictures and on pages."""
UNKNOWN_OBJECT = 3
"""Value of obstacle.tif where it is not known whether there is an obstacle."""
STEP_LINE = 4
"""Value of obstacle.tif on the line of a step that the vehicle cannot cross."""
OBJECT_COLOURS: dict[int, tuple[int, int, int, int]] = {
    FREE: (255, 255, 255, 0),
    OBSTACLE: (72, 70, 80, 255),
    CANOPY: (127, 191, 123, 255),
    UNKNOWN_OBJECT: (190, 190, 190, 255),
    STEP_LINE: (20, 18, 26, 255),
    NO_CLASS: (0, 0, 0, 0),
}
"""Red, green, blue, alpha of the values of obstacle.tif; free ground is transparent."""
PASSAGE_NAMES = ("closed", "free", "free, second area of the tile", "free, third area", "free, fourth area")
"""Names of the first values of passage.tif."""
PASSAGE_COLOURS: dict[int, tuple[int, int, int, int]] = {
    0: (72, 70, 80, 190),
    1: (166, 217, 106, 90),
    2: (253, 174, 97, 170),
    3: (171, 217, 233, 170),
    4: (194, 165, 207, 170),
    NO_CLASS: (0, 0, 0, 0),
}
"""Red, green, blue, alpha of these values."""
REASON_COLOURS: dict[int, tuple[int, int, int, int]] = {
    Reason.OK: (235, 235, 235, 255),
    Reason.NO_POINTS: (0, 0, 0, 0),
    Reason.TOO_FEW_POINTS: (194, 165, 207, 255),
    Reason.TOO_MANY_HOLES: (128, 115, 172, 255),
    Reason.NO_GROUND: (221, 119, 170, 255),
    Reason.OUTLIER_RELIEF: (230, 97, 1, 255),
}
"""Red, green, blue, alpha of each `Reason`: tiles with a class light grey, places without points transparent."""
REASON_SHADES = REASON_COLOURS | {
    Reason.TOO_FEW_POINTS: (105, 105, 105, 255),
    Reason.TOO_MANY_HOLES: (150, 150, 150, 255),
    Reason.NO_GROUND: (64, 64, 160, 255),
    Reason.OUTLIER_RELIEF: (0, 0, 64, 255),
}
"""These in GIS, where they lie beside classes: none is the colour of a class to a colour-blind reader."""
CHANGE_COLOURS: dict[int, tuple[int, int, int, int]] = {
    0: (233, 240, 226, 255),
    1: (246, 178, 72, 255),
    2: (196, 22, 40, 255),
    3: (20, 105, 178, 255),
    4: (64, 60, 68, 255),
    5: (142, 100, 170, 255),
}
"""Red, green, blue, alpha of each of ``CHANGE_KINDS``: unchanged ground pale, a change of unknown ride dark."""
COST_COLOURS: dict[float, tuple[int, int, int, int]] = {
    1.0: (252, 253, 191, 255),
    1.5: (254, 211, 149, 255),
    2.0: (254, 159, 109, 255),
    4.0: (222, 73, 104, 255),
    8.0: (140, 41, 129, 255),
    16.0: (59, 15, 112, 255),
}
"""Red, green, blue, alpha of costs (factor on distance), from pale (as good as level road) to dark."""
OFF_KINDS = (
    "map over 2 times too low",
    "map 1.5 to 2 times too low",
    "map 1.2 to 1.5 times too low",
    "map within a factor of 1.2",
    "map 1.2 to 1.5 times too high",
    "map 1.5 to 2 times too high",
    "map over 2 times too high",
    "not compared",
)
"""Meaning of each code of ``MapOffset.kind``, from too smooth to too rough."""
OFF_COLOURS: dict[int, tuple[int, int, int, int]] = {
    0: (90, 15, 110, 255),
    1: (153, 86, 176, 255),
    2: (205, 170, 216, 255),
    3: (250, 250, 250, 255),
    4: (158, 214, 152, 255),
    5: (62, 155, 76, 255),
    6: (0, 84, 40, 255),
    7: (160, 160, 160, 255),
}
"""Red, green, blue, alpha of how far a map is off a drive: purple where it reads too low, green where too high; neither
is a colour of a class, and colour-blind readers tell them apart."""
DIFFERENCE_RAMP = (
    *("#053061", "#2166ac", "#4393c3", "#92c5de", "#f7f7f7"),
    *("#f4a582", "#d6604d", "#b2182b", "#67001f"),
)
"""Colours from the least over none, white, to the most of a difference."""
ROUTE_COLOUR = (0, 0, 0)
"""Of the line of a way."""


_ANCHORS = np.array([CLASS_COLOURS[number][:3] for number in range(len(CLASS_NAMES))], np.float64)


@dataclass(frozen=True, slots=True)
class RideScale:
    """Ride costs that have the colours of the classes."""

    anchors: tuple[float, ...]
    """(4,) rising, rad/m: where each class has its own colour."""

    @classmethod
    def of(cls, manifest: Mapping[str, Any]) -> "RideScale":
        """Return the scale with the limits of the classes, so that pictures for one vehicle can be compared.

        A class has its own colour in the middle of its interval.
        """
        limits = class_limits(manifest)
        edges = [0.0, *limits, 2 * limits[-1] - limits[-2]]
        return cls(tuple((low + high) / 2 for low, high in pairwise(edges)))

    @property
    def end(self) -> float:
        """Ride cost of the last colour, rad/m; what is rougher has it too."""
        return self.anchors[-1]

    def colours(self, c_r: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return colours, (..., 3) from 0 to 255, of ride costs in rad/m; NaN as 0."""
        known = np.nan_to_num(c_r)
        return np.stack([np.interp(known, self.anchors, channel) for channel in _ANCHORS.T], axis=-1)


def class_limits(manifest: Mapping[str, Any]) -> list[float]:
    """Return the three limits of the classes, rad/m, of a map."""
    return [float(limit) for limit in manifest["calibration"]["class_limits"]]


def class_ranges(manifest: Mapping[str, Any]) -> tuple[str, ...]:
    """Return in words what is in each class, C_r in rad/m; nothing if C_r does not decide."""
    if manifest["settings"].get("compat") == "paper":
        return ()
    first, *_, last = texts = [f"{limit:.3g}" for limit in class_limits(manifest)]
    between = [f"{low} to {high}" for low, high in pairwise(texts)]
    return (f"under {first}", *between, f"{last} and more, or too steep, or drives fail")
