"""Settings of calibrations, evaluations and trainings, declared once."""

import math
import platform
from dataclasses import asdict, dataclass, field, fields, replace
from importlib.metadata import version
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from bumpymap.core import ScanMethod, Setting, UsageError, check_settings

if TYPE_CHECKING:
    from bumpymap.rating import Vehicle


def log_spaced(lowest: float, highest: float, count: int) -> tuple[float, ...]:
    """Return ``count`` values from ``lowest`` to ``highest`` in equal ratios, rounded to three digits."""
    ratio = (highest / lowest) ** (1.0 / (count - 1))
    return tuple(float(f"{lowest * ratio**step:.3g}") for step in range(count))


@dataclass(frozen=True, slots=True)
class Physics:
    """Settings of the physics engine."""

    time_step: float = 0.002
    """s."""
    friction: float = 0.9
    """Coulomb coefficient between wheel and ground."""


@dataclass(frozen=True, slots=True)
class DriveSettings:
    """Settings shared by all drives of a calibration."""

    physics: Physics = field(default_factory=Physics)
    settle_s: float = 1.0
    """Time with wheels locked at the start."""
    ramp_s: float = 1.0
    """Time of linear acceleration from rest to full speed."""
    cruise_s: float = 0.5
    """Time at full speed before the measurement, for the pitch from the acceleration to decay."""
    measure_s: float = 10.0
    sample_hz: float = 100.0
    """Sampling rate of the gyroscope and of the steering."""
    stuck_share: float = 0.2
    """A drive that covers less than this share of its distance counts as stuck."""
    rolled_deg: float = 60.0
    """A chassis that tilts further counts as rolled over."""
    margin_m: float = 1.5
    """Width of ground beyond the wheels. A vehicle pushed further than this off its line counts as stuck."""

    def __post_init__(self) -> None:
        ratio = 1 / (self.sample_hz * self.physics.time_step)
        if round(ratio) < 1 or not math.isclose(ratio, round(ratio), rel_tol=1e-9):
            raise UsageError(
                f"a time step of {self.physics.time_step} s does not divide the {1 / self.sample_hz} s between "
                "samples; choose 0.01, 0.005, 0.002, 0.001 or 0.0005 s"
            )

    @property
    def steps_per_sample(self) -> int:
        """Time steps between two samples."""
        return round(1 / (self.sample_hz * self.physics.time_step))


@dataclass(frozen=True, slots=True)
class CalibrationSettings:
    """All settings that affect the numbers of a calibration."""

    profile: "Vehicle"
    seed: Annotated[int, Setting("Random seed", "N", 0, rare=True)] = 1
    patches: Annotated[int, Setting("Patches per texture and z range", "N", 2, default="8; quick: 4", rare=True)] = 8
    """Patches per cell of the table (texture and z range)."""
    starts: Annotated[int, Setting("Drives per patch", "N", 1, default="3; quick: 1", rare=True)] = 3
    """Drives per patch of the table, each with its own start and heading."""
    z_range: tuple[float, ...] = log_spaced(0.02, 2.5, 14)
    """max - min of the table's plane-removed patches, m."""
    terrains: Annotated[int, Setting("Library terrains of each kind", "N", 1, default="24; quick: 16", rare=True)] = 24
    terrain_starts: Annotated[int, Setting("Drives per terrain", "N", 2, default="8; quick: 4", rare=True)] = 8
    tile_size: Annotated[float, Setting("Patch size in metres", "M", 0.0, unit="m", exclusive=True, group="Ground")] = (
        3.0
    )
    pixels: Annotated[int, Setting("Heightmap pixels along a side of a patch", "N", 4, rare=True)] = 15
    drive: DriveSettings = field(default_factory=DriveSettings)

    def __post_init__(self) -> None:
        check_settings(self)
        if list(self.z_range) != sorted(set(self.z_range)) or not self.z_range or self.z_range[0] <= 0:
            raise UsageError(f"z ranges are {self.z_range}; they must be positive and rise from one to the next")

    def quick(self) -> "CalibrationSettings":
        """Return a copy with a quarter of the drives: enough for a ride model, coarse for the table."""
        z_range = log_spaced(self.z_range[0], self.z_range[-1], 6)
        return replace(self, patches=4, starts=1, z_range=z_range, terrains=16, terrain_starts=4)

    @property
    def motion_starts(self) -> int:
        """Starts on each terrain that is driven at other speeds too: a quarter of its drives."""
        return max(1, self.terrain_starts // 4)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings that affect the numbers and the library versions, as plain JSON values."""
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("profile", "drive")}
        versions = {name: version(name) for name in ("bumpymap", "dartpy", "numpy")}
        return {
            "vehicle": self.profile.to_dict(),
            **own | {"z_range": list(self.z_range)},
            "drive": asdict(self.drive),
            "versions": {**versions, "python": platform.python_version(), "machine": platform.machine()},
        }


@dataclass(frozen=True, slots=True)
class ScanEvaluateSettings:
    """All settings that affect the numbers, apart from the scans."""

    method: Annotated[ScanMethod | None, Setting("Method to judge", "NAME", default="both", rare=True)] = None
    model: Annotated[Path | None, Setting("Your own scan network", "FILE", rare=True)] = None

    def __post_init__(self) -> None:
        check_settings(self)
        if self.model is not None and self.method == "filter":
            raise UsageError("`model` is a network of the learned method, and `method` is filter; give one of them")


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopSettings:
    """Settings of the training loop."""

    seed: Annotated[int, Setting("Random seed of the training data and initial weights", "N", 0, rare=True)] = 1
    epochs: Annotated[int, Setting("Number of epochs", "N", 1, rare=True)]
    learning_rate: float
    """Peak, after the warm-up."""
    weight_decay: float
    threads: Annotated[int, Setting("CPU threads; last bits of the result depend on it", "N", 1, rare=True)] = 1

    def __post_init__(self) -> None:
        check_settings(self)

    def as_options(self, *names: str) -> str:
        """Return the options of a command line that gives some of the settings."""
        return " ".join(f"--set {name}={attrgetter(name)(self)}".removesuffix(".0") for name in names)


@dataclass(frozen=True, slots=True)
class NetworkSettings:
    """Architecture of the network."""

    pixels: Annotated[int, Setting("Pixels along a side of a tile", "N", 9, rare=True)] = 15
    channels: tuple[int, int, int, int] = (16, 32, 64, 96)
    """Filters of the four convolutions."""
    hidden: int = 128
    """Units of the hidden layer between the averages over the patch and the output."""

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainSettings(LoopSettings):
    """All settings that affect a training."""

    epochs: Annotated[int, Setting("Number of epochs", "N", 1, rare=True)] = 30
    patches_per_texture: Annotated[int, Setting("Training patches per texture", "N", 1, rare=True)] = 6534
    """As in the paper: 26,136 patches in total."""
    batch: Annotated[int, Setting(low=2)] = 256
    """Minimum number of patches per optimizer step; batches are as equal in size as possible."""
    learning_rate: float = 5e-3
    weight_decay: float = 1e-2
    tile_size: Annotated[
        float, Setting("Tile size in metres", "M", 0.0, unit="m", exclusive=True, group="Ground", rare=True)
    ] = 3.0
    """Side of the tiles the network is for, m. It is metadata only: texture sizes are relative to the side."""
    network: NetworkSettings = field(default_factory=NetworkSettings)


@dataclass(frozen=True, slots=True)
class ScanNetSettings:
    """Architecture of the network."""

    stem: int = 16
    """Filters of the first convolution, which halves the resolution."""
    widths: tuple[int, ...] = (16, 24, 24, 24)
    """Channels after each inverted residual; where they increase, the resolution is halved."""
    expansion: int = 4
    """Expansion factor inside an inverted residual."""
    measure_channels: int = 16
    """Channels of the layer that takes the measures."""
    hidden: int = 48
    """Channels of the last hidden layer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanTrainSettings(LoopSettings):
    """All settings that affect a training; the scans come in addition."""

    epochs: Annotated[int, Setting("Number of epochs", "N", 1, rare=True)] = 20
    turns: Annotated[int, Setting(low=0)] = 2
    """Number of additional cuts of each scan, each after a random rotation."""
    sectors_per_class: Annotated[int, Setting("Sectors per class and epoch", "N", 1, rare=True)] = 10_000
    batch: Annotated[int, Setting(low=1)] = 128
    learning_rate: float = 4e-3
    weight_decay: float = 2e-2
    smoothing: float = 0.05
    """Label smoothing: share of each label that is spread over the other classes; labels at margins are uncertain."""
    network: ScanNetSettings = field(default_factory=ScanNetSettings)
