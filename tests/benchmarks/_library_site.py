"""A site of 96 m x 96 m made of the library's terrains: its true surface, and the layers of a survey of it."""

import sys
from dataclasses import dataclass
from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from bumpymap.api import map_survey
from bumpymap.lab.settings import CalibrationSettings
from bumpymap.lab.simulate.plan import library_terrain, library_terrains
from bumpymap.lab.simulate.terrain import PatchGround
from bumpymap.lab.worlds.terrains import Terrain
from bumpymap.rating import Calibration, Vehicle

sys.path.append(str(Path(__file__).resolve().parents[1] / "worlds"))

from driven_ways import ReliefGround

EPSG = 32632
CORNER = (512_340.0, 5_403_210.0)
SIDE_M, CELL_M, BLEND_M = 96.0, 12.0, 2.0
PIXEL_M = 0.1
DENSITY, NOISE_M = 100.0, 0.01
_ROUGHEST = 0.45


@dataclass(frozen=True)
class LibrarySite:
    """Cells of library terrain, joined smoothly, on long gentle waves."""

    heights: NDArray[np.float64]
    """(n, n) m, south row first, pixels of 10 cm."""

    @classmethod
    def of(cls, calibration: Calibration, seed: int) -> "LibrarySite":
        """Draw terrains that the vehicle of the calibration crosses, of all roughness, and join them."""
        rng = np.random.default_rng(seed)
        cells = round(SIDE_M / CELL_M)
        axis = (np.arange(round(SIDE_M / PIXEL_M)) + 0.5) * PIXEL_M
        east, north = np.meshgrid(axis, axis)
        weights = [
            np.clip((CELL_M + BLEND_M) / 2 - np.abs(axis - (c + 0.5) * CELL_M), 0, BLEND_M) for c in range(cells)
        ]
        share = np.stack(weights) / np.sum(weights, axis=0)
        heights = 1.5 * np.sin(2 * np.pi * east / 61) * np.cos(2 * np.pi * north / 47)
        for number, terrain in enumerate(_drawn(calibration, cells**2, rng)):
            row, col = divmod(number, cells)
            ground = PatchGround.from_heights(terrain.surface, terrain.tile_size)
            here = np.ix_(np.flatnonzero(share[row]), np.flatnonzero(share[col]))
            middle = terrain.tile_size / 2
            away = ground.gradient[0] * (east[here] - middle) + ground.gradient[1] * (north[here] - middle)
            residual = ground.height(east[here], north[here]) - ground.mean - away
            heights[here] += np.outer(share[row], share[col])[here] * residual
        return cls(heights)

    def along(self, _line: NDArray[np.float64]) -> tuple[ReliefGround, NDArray[np.float64]]:
        """Return the surface to drive over, and its south-west corner, m."""
        return ReliefGround(self.heights, PIXEL_M), np.array(CORNER)

    def survey(self, path: Path, seed: int) -> None:
        """Write a survey with 100 points per square metre and 1 cm of noise."""
        rng = np.random.default_rng(seed)
        east, north = rng.uniform(0, SIDE_M, (2, round(DENSITY * SIDE_M**2)))
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.add_crs(CRS.from_epsg(EPSG))
        header.scales, header.offsets = [0.001] * 3, [*CORNER, 0.0]
        cloud = laspy.LasData(header)
        cloud.x, cloud.y = east + CORNER[0], north + CORNER[1]
        cloud.z = (
            100 + ReliefGround(self.heights, PIXEL_M).height(east, north) + NOISE_M * rng.standard_normal(len(east))
        )
        cloud.write(path)


def _drawn(calibration: Calibration, count: int, rng: np.random.Generator) -> list[Terrain]:
    """Draw terrains so that ln C_r is evenly spread."""
    settings = CalibrationSettings(
        Vehicle.from_dict(calibration.vehicle, "the calibration"), seed=int(calibration.settings["seed"])
    )
    easy = [t for t in library_terrains(calibration) if t.c_r and t.c_r < _ROUGHEST and t.stuck + t.rolled == 0]
    easy.sort(key=lambda terrain: terrain.c_r or 0.0)
    logs = np.log([terrain.c_r for terrain in easy])
    wanted = rng.uniform(logs[0], logs[-1], count)
    chosen = [easy[int(np.abs(logs - value).argmin())] for value in wanted]
    return [library_terrain(settings, terrain.kind, terrain.index) for terrain in chosen]


def library_layers(work: Path, calibration: Calibration) -> tuple[LibrarySite, Path]:
    """Make the site, and its layers if they are not in the folder yet."""
    site, layers = LibrarySite.of(calibration, 5), work / "library_layers"
    if not (layers / "run.json").exists():
        survey = work / "library_site.laz"
        site.survey(survey, 6)
        map_survey(survey, layers, vehicle=str(calibration.vehicle["name"]))
    return site, layers
