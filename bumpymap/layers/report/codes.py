"""Grids of bytes as text: numbers are rounded to 255 steps, packed and written in base 64."""

import base64
import math
import zlib
from dataclasses import dataclass
from typing import Any, Literal, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["NOT_KNOWN", "ByteGrid", "packed"]

NOT_KNOWN = 255
"""Byte where a value is not known."""
_STEPS = 254
_LEAST = 1e-4
"""Smallest value of a logarithmic scale."""


Scale: TypeAlias = Literal["linear", "log", "root"]
"""``root``: steps of the square root, for differences of which most are small."""


@dataclass(frozen=True, slots=True)
class ByteGrid:
    """A grid whose byte b stands for ``low + b step``, for its exponential, or for its square with the sign kept."""

    key: str
    label: str
    unit: str
    decimals: int
    scale: Scale
    low: float
    step: float
    codes: NDArray[np.uint8]
    """(rows, cols), north row first; ``NOT_KNOWN`` where there is no value."""

    @classmethod
    def of(
        cls,
        about: tuple[str, str, str, int],
        values: NDArray[np.float32],
        scale: Scale = "linear",
        limits: tuple[float, float] | None = None,
    ) -> Self:
        """Round values, (rows, cols), NaN where unknown, to 255 steps between ``limits``, or between their extremes.

        ``about`` is key, label, unit, and how many decimals are worth showing. Values beyond the limits take those.
        """
        with np.errstate(divide="ignore"):
            plain = values.astype(np.float64)
            if scale == "log":
                plain = np.log(np.maximum(values, _LEAST))
            elif scale == "root":
                plain = np.sign(plain) * np.sqrt(np.abs(plain))
        known = np.isfinite(plain)
        if scale == "root" and known.any():  # as far down as up, so that 0 is in the middle, and exact
            most = float(np.abs(plain[known]).max())
            limits = (-most, most)
        low, high = limits or ((float(plain[known].min()), float(plain[known].max())) if known.any() else (0.0, 1.0))
        step = (high - low) / _STEPS or 1.0
        codes = np.full(values.shape, NOT_KNOWN, np.uint8)
        codes[known] = np.clip(np.rint((plain[known] - low) / step), 0, _STEPS).astype(np.uint8)
        return cls(*about, scale, low, step, codes)

    @property
    def rounding(self) -> str:
        """How far a shown value may be from the one in the layers."""
        if not (self.codes != NOT_KNOWN).any():
            return f"{self.label}: no value"
        if self.scale == "log":
            return f"{self.label} ±{100 * math.expm1(self.step / 2):.2g} %"
        unit = f" {self.unit}" if self.unit not in {"", "°"} else self.unit
        if self.scale == "root":  # most where values are largest
            most = max(abs(self.low), abs(self.low + _STEPS * self.step))
            return f"{self.label} at most ±{self.step * most:.1g}{unit}"
        return f"{self.label} ±{self.step / 2:.2g}{unit}"

    def span(self) -> tuple[float, float, float]:
        """Return the least value of the scale, that in its middle, and the largest."""
        ends = [self.low + self.step * part * _STEPS for part in (0.0, 0.5, 1.0)]
        least, middle, most = (float(self._value(np.array(round(end, 12)))) + 0.0 for end in ends)
        return least, middle, most

    def values(self) -> NDArray[np.float64]:
        """Return what the page shows, NaN where unknown."""
        plain = self.low + self.step * self.codes.astype(np.float64)
        return np.where(self.codes == NOT_KNOWN, np.nan, self._value(plain))

    def _value(self, plain: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.scale == "linear":
            return plain
        return np.asarray(np.exp(plain) if self.scale == "log" else plain * np.abs(plain))

    def record(self) -> dict[str, Any]:
        """Return the grid as plain JSON."""
        keys = ("key", "label", "unit", "decimals", "scale", "low", "step")
        return {key: getattr(self, key) for key in keys} | {"codes": packed(self.codes)}


def packed(codes: NDArray[np.uint8]) -> str:
    """Return bytes compressed (zlib) in base 64."""
    return base64.b64encode(zlib.compress(np.ascontiguousarray(codes).tobytes(), 6)).decode()
