"""Points of tiles in, rated tiles out: the steps that a run applies to every block."""

import logging
from dataclasses import dataclass, replace
from typing import Any

from numpy.typing import NDArray

from bumpymap.core import Compat, CsfSettings, FeatureSettings, Georeference, MapConfig
from bumpymap.patches import mark_ground, measure, require_filter
from bumpymap.rating import Calibration, RideModel, TextureModel, classify, find_calibration, rate, rate_as_paper
from bumpytiles import Grid, TilePoints

__all__ = ["RatingModels", "TileRating", "require_cloth"]

_log = logging.getLogger(__name__)


def require_cloth(config: MapConfig) -> None:
    """Check that the cloth filter is installed if the settings ask for it, and warn of what it removes."""
    if config.ground != "csf":
        return
    require_filter(config.csf, Grid(config.tile_size, config.pixels))
    _log.warning(
        "`ground='csf'` removes everything that stands more than %g m above the ground, boulders and posts as "
        "well as trees. The layers show how rough the ground is, not whether it is free of obstacles",
        config.csf.class_threshold,
    )


@dataclass(frozen=True, slots=True)
class RatingModels:
    """The texture network and the vehicle's calibration."""

    texture: TextureModel
    calibration: Calibration

    @classmethod
    def load(cls, config: MapConfig) -> "RatingModels":
        """Load both, and check that they were made for the tiles of the run.

        Raises
        ------
        BumpymapError
            A file cannot be read, or is for tiles of another size.
        """
        calibration = find_calibration(config.vehicle, config.calibration)
        texture = TextureModel.load(config.model) if config.model else TextureModel.shipped()
        texture.require_grid(config.tile_size, config.pixels)
        calibration.require_grid(config.tile_size, config.pixels)
        return cls(texture, calibration)


@dataclass(frozen=True, slots=True)
class TileRating:
    """Rates the points of tiles; picklable, because other threads and machines run it."""

    features: FeatureSettings
    csf: CsfSettings | None
    """None: the classes in the survey say what is ground."""
    compat: Compat
    models: RatingModels
    ride: RideModel | None
    """None: rate by texture and relief."""
    georeference: Georeference

    @classmethod
    def of(cls, config: MapConfig, models: RatingModels, georeference: Georeference) -> "TileRating":
        """Choose the steps that the settings ask for."""
        csf = config.csf if config.ground == "csf" else None
        ride = RideModel(models.calibration) if config.rating == "ride" and config.compat == "none" else None
        return cls(config.features, csf, config.compat, models, ride, georeference)

    def __call__(self, points: TilePoints, ground_only: bool) -> dict[str, NDArray[Any]]:
        """Find the ground, measure, classify and rate; return the columns of `tile_columns`."""
        if self.csf is not None:
            points = replace(points, flag=mark_ground(points, self.csf))
        patches = measure(points, self.features, ground_only=ground_only)
        textures = classify(patches, self.models.texture)
        if self.ride is not None:
            return self.ride.rate(patches, textures, self.georeference).columns()
        rating = rate_as_paper if self.compat == "paper" else rate
        return rating(patches, textures, self.models.calibration, self.georeference).columns()
