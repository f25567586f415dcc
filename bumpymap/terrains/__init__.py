"""The terrain library: seeded ground of many kinds, as a surface, a heightmap or the points that a survey has of it."""

from bumpymap.terrains.library import KINDS, Terrain, make_terrain
from bumpymap.terrains.survey import ScanEffects, TerrainPoints, survey_terrain

__all__ = ["KINDS", "ScanEffects", "Terrain", "TerrainPoints", "make_terrain", "survey_terrain"]
