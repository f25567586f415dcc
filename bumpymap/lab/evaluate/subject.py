"""The subject of an evaluation: a vehicle's calibration and its ratings."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CostMap, Georeference, PatchStack, Rating, TextureMap
from bumpymap.rating import Calibration, RideModel, TextureModel, Vehicle, classify, rate

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["MAPPED", "NoisyRide", "Rate", "Subject", "Verdict"]

Rate = Callable[[PatchStack, TextureMap, Georeference], CostMap]
MAPPED = ("ride", "table")
"""Ratings of ``map``."""
_PLACELESS = Georeference(None)


class NoisyRide(RideModel):
    """The ride model without noise correction; it rates the measured ground, over which the drives run too."""

    def ground(self, patches: PatchStack) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """Return the relief as measured, and no noise."""
        return patches.relief_map, np.zeros(len(patches.count))


@dataclass(frozen=True, slots=True)
class Verdict:
    """Results of one rating for n tiles, with the fields of `CostMap`."""

    class_id: NDArray[np.uint8]
    c_r: NDArray[np.float64]
    c_r_low: NDArray[np.float64]
    c_r_high: NDArray[np.float64]
    p_fail: NDArray[np.float64]
    confidence: NDArray[np.float64]

    @classmethod
    def of(cls, cost_map: CostMap) -> "Verdict":
        """Copy the fields from a cost map."""
        floats = [getattr(cost_map, f.name).astype(np.float64) for f in fields(cls)[1:]]
        return cls(cost_map.class_id, *floats)

    @classmethod
    def join(cls, parts: "Sequence[Verdict]") -> "Verdict":
        """Concatenate the tiles of several verdicts."""
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> "Verdict":
        """Select tiles."""
        return Verdict(*(getattr(self, f.name)[rows] for f in fields(self)))


@dataclass(frozen=True)
class Subject:
    """A calibrated vehicle and its ratings."""

    calibration: Calibration
    profile: Vehicle
    ratings: Mapping[str, Rate]
    """Name -> rating: ``ride``, ``ride_raw`` (see `NoisyRide`), ``table``."""
    textures: TextureModel
    ride: RideModel | None = None
    """The model of the ``ride`` rating."""

    @classmethod
    def of(cls, calibration: Calibration, textures: TextureModel, rating: Rating) -> "Subject":
        """Make the ratings of a calibration.

        Raises
        ------
        UsageError
            The calibration has no ride model but the rating needs one, or the texture network is for other tiles.
        """
        textures.require_grid(calibration.tile_size, calibration.pixels)
        calibration = calibration.without_floor()  # it is held against simulated drives, which have none
        profile = Vehicle.from_dict(calibration.vehicle, f"calibration {calibration.id}")

        def by_table(patches: PatchStack, seen: TextureMap, place: Georeference) -> CostMap:
            return rate(patches, seen, calibration, place)

        if rating == "table":
            return cls(calibration, profile, {"table": by_table}, textures)
        ride = RideModel(calibration)
        ratings: dict[str, Rate] = {"ride": ride.rate, "ride_raw": NoisyRide(calibration).rate, "table": by_table}
        return cls(calibration, profile, ratings, textures, ride)

    @property
    def name(self) -> str:
        """Name of the vehicle."""
        return str(self.calibration.vehicle["name"])

    @property
    def key(self) -> str:
        """Name of the vehicle and eight digits of the hash of its profile, which determines its drives."""
        text = json.dumps(self.calibration.vehicle, sort_keys=True)
        return f"{self.name}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"

    @property
    def main(self) -> str:
        """The rating by which patches are chosen."""
        return "ride" if "ride" in self.ratings else "table"

    def judge(self, patches: PatchStack, names: "Sequence[str] | None" = None) -> dict[str, Verdict]:
        """Rate tiles with the named ratings; with all by default."""
        seen = classify(patches, self.textures)
        return {
            name: Verdict.of(rating(patches, seen, _PLACELESS))
            for name, rating in self.ratings.items()
            if names is None or name in names
        }
