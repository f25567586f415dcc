"""Settings of a scan run. All have defaults except the frames and the folder of the products."""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from bumpymap.core import (
    GridSettings,
    NameOrFile,
    PolarSettings,
    Robot,
    ScanMethod,
    Setting,
    UsageError,
    check_settings,
)

if TYPE_CHECKING:
    from bumpymap.readers import BagTopics

ScanProduct = Literal["table", "cloud"]
SCAN_PRODUCTS: tuple[ScanProduct, ...] = get_args(ScanProduct)


@dataclass(frozen=True, slots=True)
class ScanConfig:
    """All settings of a scan run."""

    frames: tuple[Path, ...]
    """Files of scans, folders of them, or bags."""
    out: Annotated[Path, Setting("Folder for the output", "DIR", group="Output")]
    topic: Annotated[
        str | None, Setting("Topics of the scans in a bag", "NAME[,NAME]", default="the only one", group="Input")
    ] = None
    odometry: Annotated[
        str | None, Setting("Topic of the poses in a bag", "NAME", default="the only one, or tf", group="Input")
    ] = None
    bag: Annotated[Path | None, Setting("Write the grids of all frames to a bag (.mcap)", "FILE", group="Output")] = (
        None
    )
    poses: Annotated[Path | None, Setting("Poses of the frames, to map them like a survey", "FILE", group="Input")] = (
        None
    )
    trust_poses: Annotated[bool, Setting("Map a drive whose poses contradict its frames", rare=True)] = False
    """Merge the frames even if they show that the poses are wrong; it is said, but not refused."""
    correct_poses: Annotated[bool, Setting("Correct small errors of the poses of a drive", rare=True)] = False
    """Register the frames to each other (extra ``poses``); else poses are taken as given, and tested."""
    crs: Annotated[
        str | None, Setting("CRS of the poses: EPSG:32614", "CRS", default="local metres", group="Input")
    ] = None
    deskew: Annotated[bool, Setting("Keep points as measured in motion", option="no-deskew", rare=True)] = True
    """Move points to where they are seen at the time of the frame, if poses and points have times."""
    columns: Annotated[
        Literal[4, 5, 6] | None, Setting("Columns of .bin files: 4, 5 or 6", "N", default="by their values", rare=True)
    ] = None
    method: Annotated[
        ScanMethod | None, Setting("How sectors are classified: filter or learned", "NAME", default="", group="Ground")
    ] = None
    """None: learned if a network for the grid is included, else filter."""
    model: Annotated[Path | None, Setting("ONNX file of your own scan network (learned)", "FILE", rare=True)] = None
    products: Annotated[tuple[ScanProduct, ...], Setting("What to write for each frame", "LIST", rare=True)] = (
        SCAN_PRODUCTS
    )
    pictures: Annotated[int, Setting(low=0)] = 0
    """Draw a picture of every Nth frame; 0: of none."""
    range_m: Annotated[
        float, Setting("A picture reaches as far as this", "M", 1.0, 1000.0, "m", option="range", rare=True)
    ] = 40.0
    threads: Annotated[int, Setting("Frames to work on at a time", "N", 1, default="all cores", rare=True)] = field(
        default_factory=lambda: os.cpu_count() or 1
    )
    vehicle: Annotated[
        NameOrFile | None, Setting("Vehicle whose ride is rated: name or TOML file", "NAME|FILE", group="Vehicle")
    ] = None
    """Its belly and height say what an obstacle is. It is also that of the mapped layers; None: no ride, and the map of
    the default."""
    calibration: Annotated[Path | None, Setting("Calibration file of your own vehicle", "FILE", group="Vehicle")] = None
    skip_bad: Annotated[bool, Setting("Skip frames that cannot be read (exit code 4)", group="Input")] = False
    overwrite: Annotated[bool, Setting("Replace the output of an earlier run", group="Output")] = False
    polar: PolarSettings = field(default_factory=PolarSettings)
    robot: Robot = field(default_factory=Robot)
    grid: GridSettings = field(default_factory=GridSettings)
    """Size of the grids in ``bag``."""

    def __post_init__(self) -> None:
        if {*self.products} - {*SCAN_PRODUCTS} or not (self.products or self.poses or self.pictures):
            raise UsageError(
                f"`products` is {', '.join(self.products) or 'empty'}; give one or more of {', '.join(SCAN_PRODUCTS)}. "
                "Pictures of frames are drawn with `pictures`"
            )
        check_settings(self)
        if self.model is not None and self.method == "filter":
            raise UsageError("`model` is a network of the learned method, and `method` is filter; give one of them")
        if self.poses is not None and self.odometry is not None:
            raise UsageError("`poses` and `odometry` both say where the frames were taken: give one of them")
        if self.poses is not None and len(self.bag_topics.clouds) > 1:
            raise UsageError(f"`poses` are those of one sensor, and `topic` is {self.topic}; name one topic")
        if self.bag is not None and self.bag.suffix.lower() != ".mcap":
            raise UsageError(f"`bag` is {self.bag}; it is the name of a file that ends in .mcap")
        if not self.may_have_poses:
            self.refuse_crs()

    @property
    def may_have_poses(self) -> bool:
        """True if poses are given, or bags that may hold some."""
        from bumpymap.readers import bags_at

        return self.poses is not None or any(map(bags_at, self.frames))

    @property
    def bag_topics(self) -> "BagTopics":
        """Topics of a bag that are read."""
        from bumpymap.readers import BagTopics

        topics = tuple(filter(None, (self.topic or "").split(",")))
        return BagTopics(topics, self.odometry, poses=self.poses is None)

    def refuse_crs(self) -> None:
        """Raise UsageError if there is a CRS; for runs without poses."""
        if self.crs is not None:
            raise UsageError(
                "`crs` applies to the map of a drive, which needs the pose of every frame: add `poses='FILE'`"
            )
