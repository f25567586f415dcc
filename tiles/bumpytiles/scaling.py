"""Coordinates as integers of a file's own grid: exact, in half the bytes of floating-point numbers."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from bumpytiles.native import helper

DECIMALS = 8
"""Decimals that coordinates are rounded to, in the file's unit."""
_ROUND = 10.0**DECIMALS

Triple = tuple[float, float, float]


@helper
def coordinate(number: int, scaling: Annotated[NDArray[np.float64], 1], axis: int) -> float:
    """Return a coordinate in metres from the integer of an axis, see `Scaling`: the same bits as of its method."""
    there = np.rint((number * scaling[axis] + scaling[3 + axis]) * _ROUND) / _ROUND
    return float(there * scaling[6 + axis])


@helper
def coordinates(
    numbers: Annotated[NDArray[np.int32], 1],
    scaling: Annotated[NDArray[np.float64], 1],
    axis: int,
    out: Annotated[NDArray[np.float64], 1],
) -> None:
    """Do the same for many integers of an axis."""
    scale, offset, unit = scaling[axis], scaling[3 + axis], scaling[6 + axis]
    for i in range(len(numbers)):
        out[i] = np.rint((numbers[i] * scale + offset) * _ROUND) / _ROUND * unit


@dataclass(frozen=True, slots=True)
class Scaling:
    """How integers become coordinates: ``integer * scale + offset``, rounded to 1e-8, times the metres of the unit."""

    scales: Triple
    offsets: Triple
    units: Triple
    """m, of x, y and z."""

    def numbers(self) -> NDArray[np.float64]:
        """Return scales, offsets and units as an array (9,) for kernels."""
        return np.array([*self.scales, *self.offsets, *self.units])

    @classmethod
    def of(cls, numbers: Any) -> "Scaling":
        """Restore it from nine numbers."""
        x, y, z, *others = (float(number) for number in numbers)
        return cls((x, y, z), (others[0], others[1], others[2]), (others[3], others[4], others[5]))

    def coordinates(self, axis: int, integers: Any) -> NDArray[np.float64]:
        """Return coordinates, m, of integers (n,) of an axis; too large ones become infinite or not a number."""
        with np.errstate(over="ignore", invalid="ignore"):
            there = np.asarray(integers, np.float64) * self.scales[axis] + self.offsets[axis]
            found: NDArray[np.float64] = np.rint(there * _ROUND) / _ROUND * self.units[axis]
        return found


@dataclass(frozen=True, slots=True)
class ScaledPoints:
    """Points of one file, (n,) each."""

    easting: NDArray[np.int32]
    """Integers of the file's grid, as the two that follow."""
    northing: NDArray[np.int32]
    upward: NDArray[np.int32]
    flag: NDArray[np.uint8]
    """A number that travels with each point."""
    scaling: Scaling
    colour: NDArray[np.uint32] | None = None
    """Red, green and blue, 8 bits each, blue lowest; 0: none. None: no point has one."""

    def coordinates(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return easting, northing and height, m."""
        east, north, up = (
            self.scaling.coordinates(axis, values)
            for axis, values in enumerate((self.easting, self.northing, self.upward))
        )
        return east, north, up
