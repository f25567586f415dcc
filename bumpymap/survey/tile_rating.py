"""Points of tiles in, rated tiles out: the steps that a run applies to every block."""

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    EMPTY,
    POINT_GROUND,
    POINT_OTHER,
    SEEN,
    UNSEEN,
    MapConfig,
    PatchStack,
    smallest_object,
)
from bumpymap.patches import (
    decks_as_ground,
    find_in_relief,
    find_objects,
    leave_out_standing,
    mark_ground,
    measure,
    measure_thin,
    take_off_standing,
)
from bumpymap.rating import (
    Calibration,
    RideModel,
    TextureModel,
    at_speed,
    classify,
    find_calibration,
    map_rule,
    rate,
    rate_as_paper,
    shipped_calibrations,
    thin_columns,
)
from bumpytiles import TilePoints

_log = logging.getLogger(__name__)


# What is part of the package is read once by a process that maps many surveys.
_included, _shipped = lru_cache(4)(find_calibration), lru_cache(1)(TextureModel.shipped)


@dataclass(frozen=True, slots=True)
class RatingModels:
    """The texture network and the vehicle's calibration."""

    texture: TextureModel | None
    """None: the columns of the texture stay empty."""
    calibration: Calibration

    @classmethod
    def load(cls, config: MapConfig) -> "RatingModels":
        """Load both, and check that they were made for the tiles of the run.

        The ride model does not need the texture, so tiles for which there is no network are rated without. Raises
        BumpymapError: a file cannot be read, or is for tiles of another size.
        """
        is_included = config.calibration is None and str(config.vehicle) in shipped_calibrations()
        find = _included if is_included else find_calibration
        calibration = find(config.vehicle, config.calibration, config.tile_size)
        calibration.require_grid(config.tile_size, config.pixels)
        calibration = at_speed(calibration, config.speed)
        own = float(calibration.vehicle["speed_mps"])
        fastest = max(calibration.map_speed, map_rule(calibration).top_mps)
        if fastest > own * (1.0 + 1e-5):
            _log.warning("p_fail is that of drives at %g m/s: at %g m/s more of them may fail", own, fastest)
        texture = TextureModel.load(config.model) if config.model else _shipped()
        fits = (texture.tile_size, texture.pixels) == (config.tile_size, config.pixels)
        if not fits and config.model is None and config.by_ride:
            return cls(None, calibration)
        texture.require_grid(config.tile_size, config.pixels)
        return cls(texture, calibration)

    @property
    def texture_id(self) -> str | None:
        """The ``id`` of the texture network; None without one."""
        return None if self.texture is None else self.texture.id


@dataclass(frozen=True, slots=True)
class TileRating:
    """Rates the points of tiles; picklable, because other threads and machines run it."""

    config: MapConfig
    models: RatingModels
    ride: RideModel | None
    """None: rate by texture and relief."""
    most_seen: float = math.inf
    """Points per m2 of which more show nothing more."""

    @classmethod
    def of(cls, config: MapConfig, models: RatingModels, most_seen: float = math.inf) -> "TileRating":
        """Choose the steps that the settings ask for."""
        ride = RideModel(models.calibration, headings=config.headings) if config.by_ride else None
        return cls(config, models, ride, most_seen)

    def measure_all(self, points: TilePoints) -> PatchStack:
        """Measure tiles from all of their points."""
        return measure(points, self.config.features, ground_only=False)

    def __call__(
        self,
        points: TilePoints,
        ground_only: bool,
        patches: PatchStack | None = None,
        around: Mapping[str, NDArray[Any]] | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Find the ground and standing objects, measure, classify and rate; return the columns of `tile_columns`.

        ``patches`` are the tiles measured, and ``around`` the heights of these and of those beside them, if all points
        count as ground, see `bumpymap.patches.find_in_relief`.
        """
        points, config = decks_as_ground(points), self.config
        if config.ground == "csf":
            ground = mark_ground(points, config.csf)
            of_file = np.where(points.flag == POINT_GROUND, POINT_OTHER, points.flag)
            points = replace(points, flag=np.where(ground, POINT_GROUND, of_file).astype(np.uint8))
        if patches is None:
            patches = measure(points, config.features, ground_only=ground_only)
        body, objects, bare, on_ground = self.models.calibration.body, None, patches, ground_only
        if ground_only:
            # The cloth takes low objects for ground.
            apart = take_off_standing(points, patches, body) if config.ground == "csf" else (points, patches)
            objects = find_objects(*apart, body)
        elif config.compat == "none":  # the paper knows none
            found = find_in_relief(points, patches, body, around)
            points, bare = leave_out_standing(points, patches, found, config.features)
            objects = found[0]
            on_ground = True
        probability = None if self.models.texture is None else classify(bare, self.models.texture)
        if self.ride is not None:
            rated = self.ride.rate(bare, probability)
        else:
            rating = rate_as_paper if config.compat == "paper" else rate
            rated = rating(bare, np.asarray(probability), self.models.calibration)
        # How thin a tile is, and whether it has holes, depends on its survey, and not on standing objects.
        thin = None
        if self.ride is not None:
            pairs, maps = measure_thin(points, patches, config.features, ground_only=on_ground)
            thin = thin_columns(pairs, maps, bare.count, self.ride.operator)
        measured = replace(patches, relief=bare.relief, slope=bare.slope, reason=bare.reason)
        if objects is not None:
            states, size = objects.objects, points.grid.tile_size
            count = np.minimum(np.diff(points.starts), self.most_seen * size**2)
            held = (states != UNSEEN) & (states % SEEN != EMPTY)
            smallest = smallest_object(held, count, size, in_relief=not ground_only)
            rated = replace(rated, all_density=(count / size**2).astype(np.float32), smallest_object=smallest)
        return replace(rated, patches=measured, objects=objects, thin=thin).columns()
