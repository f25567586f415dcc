"""Settings of a scan run. All have defaults except the frames and the folder of the products."""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from bumpymap.core import RESUME_OR_OVERWRITE, Compat, NameOrFile, PolarSettings, ScanMethod, UsageError
from bumpymap.layers import GridSettings
from bumpymap.readers import BIN_COLUMNS, BagTopics, Robot, bags_at

__all__ = ["SCAN_PRODUCTS", "ScanConfig", "ScanProduct"]

ScanProduct = Literal["polygons", "table", "cloud"]
SCAN_PRODUCTS: tuple[ScanProduct, ...] = get_args(ScanProduct)


@dataclass(frozen=True, slots=True)
class ScanConfig:
    """All settings of a scan run."""

    frames: tuple[Path, ...]
    """Files of scans, folders of them, or bags."""
    out: Path
    """Folder for the products; of a fit, the file for the stripe classes."""
    topic: str | None = None
    """Topic of the scans in a bag; None: the only one of its type."""
    odometry: str | None = None
    """Topic of the odometry in a bag; None: the only one of its type, or else the transforms (tf)."""
    bag: Path | None = None
    """File (``.mcap``) for the grids of all frames, as messages of ROS 2."""
    poses: Path | None = None
    """File with the pose of the sensor at each frame; the frames are then merged and mapped like a survey."""
    crs: str | None = None
    """CRS of the poses, in metres; None: local coordinates."""
    deskew: bool = True
    """Move points to where they are seen at the time of the frame, if poses and points have times."""
    columns: int | None = None
    """Number of float32 columns of ``.bin`` files: 4, 5 or 6; None: told from their values."""
    labels: NameOrFile | None = None
    """Label set that labels must be of: ``kitti``, ``semantic-kitti``, ``rellis``, or a CSV or TOML file."""
    method: ScanMethod | None = None
    """How sectors are classified; None: learned if a network for the grid is included, else filter."""
    model: Path | None = None
    """A scan network, instead of the included one."""
    stripes: Path | None = None
    """Stripe classes of the filter method, instead of the included ones."""
    compat: Compat = "none"
    """``paper``: fit the stripe classes in every scan, as the paper does."""
    products: tuple[ScanProduct, ...] = SCAN_PRODUCTS
    """Which files are written for the frames."""
    pictures: int = 0
    """Draw a picture of every Nth frame; 0: of none."""
    range_m: float = 40.0
    """Distance from the sensor to the edge of a picture, m."""
    threads: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Number of threads; each works on one frame at a time."""
    vehicle: NameOrFile | None = None
    """Vehicle whose ride on each sector is told, and whose belly and height say what an obstacle is: a name or a TOML
    file, as for ``bumpymap map``. It is also that of the mapped layers; None: no ride, and the map of the default."""
    calibration: Path | None = None
    """A calibration file, instead of ``vehicle``."""
    skip_bad: bool = False
    """Skip frames that cannot be read."""
    overwrite: bool = False
    """Replace the products of an earlier run."""
    resume: bool = False
    """Continue an interrupted run."""
    polar: PolarSettings = field(default_factory=PolarSettings)
    robot: Robot = field(default_factory=Robot)
    grid: GridSettings = field(default_factory=GridSettings)
    """Size of the grids in ``bag``."""

    def __post_init__(self) -> None:
        unknown = sorted(set(self.products) - set(SCAN_PRODUCTS))
        if unknown or not (self.products or self.poses or self.pictures):
            raise UsageError(
                f"`products` is {', '.join(self.products) or 'empty'}; give one or more of {', '.join(SCAN_PRODUCTS)}. "
                "Pictures of frames are drawn with `pictures`"
            )
        self._check_numbers()
        if self.columns not in {None, *BIN_COLUMNS}:
            raise UsageError(f"`columns` is {self.columns}; .bin files have 4, 5 or 6 columns")
        if self.resume and self.overwrite:
            raise UsageError(RESUME_OR_OVERWRITE)
        learned, own_filter = self.method == "learned", self.stripes is not None or self.compat == "paper"
        if (learned and own_filter) or (self.method == "filter" and self.model) or (self.model and own_filter):
            raise UsageError(
                "`model` belongs to the learned method, `stripes` and `compat='paper'` to the filter; give options "
                "of one"
            )
        if self.stripes is not None and self.compat == "paper":
            raise UsageError("`compat='paper'` fits stripe classes in every scan, so it cannot use those of `stripes`")
        if self.poses is not None and self.odometry is not None:
            raise UsageError("`poses` and `odometry` both say where the frames were taken: give one of them")
        if self.bag is not None and self.bag.suffix.lower() != ".mcap":
            raise UsageError(f"`bag` is {self.bag}; it is the name of a file that ends in .mcap")
        if not self.may_have_poses:
            self.refuse_map_settings()

    def _check_numbers(self) -> None:
        for name, least in (("pictures", 0), ("threads", 1)):
            if getattr(self, name) < least:
                raise UsageError(f"`{name}` is {getattr(self, name)}; it must be a whole number, at least {least}")
        if not 1.0 <= self.range_m <= 1000.0:
            raise UsageError(f"`range_m` is {self.range_m:g}; it must be a number from 1 to 1000 m")

    @property
    def may_have_poses(self) -> bool:
        """Whether poses are given, or bags that may hold some."""
        return self.poses is not None or any(map(bags_at, self.frames))

    @property
    def bag_topics(self) -> BagTopics:
        """Which topics of a bag are read."""
        return BagTopics(self.topic, self.odometry, poses=self.poses is None)

    @property
    def rates_ride(self) -> bool:
        """Whether the ride of a vehicle on each sector is told."""
        return (self.vehicle is not None or self.calibration is not None) and self.finds_ground

    @property
    def finds_ground(self) -> bool:
        """Whether ground points are found; False: all points are taken for ground, as in the paper."""
        return self.compat == "none" and self.polar.ground_only

    def refuse_map_settings(self) -> None:
        """Raise UsageError if there are settings for the map of the drive alone; for runs without poses."""
        if self.crs is not None:
            raise UsageError(
                "`crs` applies to the map of a drive, which needs the pose of every frame: add `poses='FILE'`"
            )
        names = [name for name in ("vehicle", "calibration") if getattr(self, name) is not None]
        if names and not self.finds_ground:
            raise UsageError(
                f"`{names[0]}` rates the ground of a scan, and as in the paper no ground is found in it: leave out "
                f"`compat='paper'` (and ground_only), or `{names[0]}`"
            )
