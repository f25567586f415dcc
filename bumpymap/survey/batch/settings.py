"""Settings of a map as keywords of a Python call; those of a batch, and of each survey: options over CSV over TOML."""

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Integral
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypedDict

from bumpymap.core import (
    CLASHES,
    LEAST_MEMORY,
    Align,
    Compat,
    CsfSettings,
    FeatureSettings,
    Ground,
    LengthUnit,
    MapConfig,
    PageSettings,
    Rating,
    Setting,
    UsageError,
    auto_memory,
    check_settings,
    is_auto,
    memory_bytes,
    memory_limit,
    override_settings,
    refuse_clashes,
    settings_of_call,
    short_repr,
    with_pixels,
)

PathLike: TypeAlias = str | os.PathLike[str]


class MapSettings(TypedDict, total=False):
    """Settings of `map_survey`, and of each survey of `map_batch`: fields of ``MapConfig``; paths may be strings."""

    tile_size: float
    pixels: int
    ground: Ground
    ground_classes: Sequence[int]
    align: Align
    rating: Rating
    compat: Compat
    vehicle: PathLike
    calibration: PathLike | None
    speed: float | None
    model: PathLike | None
    crs: str | int | None
    force_crs: str | int | None
    xy_unit: LengthUnit | None
    z_unit: LengthUnit | None
    dtm: bool
    photo: PathLike | None
    local: bool
    trust_points: bool
    skip_bad: bool
    max_unknown: float | None
    overwrite: bool
    threads: int
    memory: str
    scratch: PathLike | None
    scheduler: str | None
    provider: str
    license: str
    features: FeatureSettings | Mapping[str, Any]
    csf: CsfSettings | Mapping[str, Any]
    page: PageSettings | Mapping[str, Any]


def map_settings(settings: Mapping[str, Any], function: str, known: Collection[str]) -> dict[str, Any]:
    """Check the keyword arguments of a call for the fields of ``MapConfig``; ``known`` are all that it has."""
    given = dict(settings)
    for name in ("crs", "force_crs"):
        crs = given.get(name)
        if isinstance(crs, Integral) and not isinstance(crs, bool):
            given[name] = f"EPSG:{crs}"
        elif crs is not None and not isinstance(crs, str):
            raise UsageError(
                f"{name} is {short_repr(crs)}; give a code such as {name}='EPSG:32614', a PROJ string or WKT"
            )
    own = settings_of_call(given, MapConfig, function, known)
    refuse_clashes(own, CLASHES)
    return own


SurveyPer: TypeAlias = Literal["file", "folder"]
OWN_SETTINGS = ("surveys", "out", "overwrite", "threads", "memory", "scratch", "scheduler")
"""Settings of a map that a batch decides for each survey, or shares out."""
_SMALL, _JOB_MEMORY = 20_000_000, 512 << 20
"""Most bytes of a small survey, some 4 million points as LAZ, and memory of the process that maps it."""


@dataclass(frozen=True, slots=True)
class BatchConfig:
    """All settings of a ``batch`` run."""

    source: Path
    """A folder of surveys, a text file with a path in each line, or a CSV."""
    out: Annotated[Path, Setting("Gets a folder of layers for each survey", "DIR", group="Output")]
    """Folder that gets a folder of layers for each survey."""
    given: Mapping[str, Any] = field(default_factory=dict)
    """Settings of `MapConfig` for all surveys; they override those of the CSV."""
    defaults: Mapping[str, Any] = field(default_factory=dict)
    """The same, of a settings file; the CSV overrides them."""
    survey_per: Annotated[SurveyPer, Setting("What in SOURCE is one survey: file or folder", "WHAT", group="Input")] = (
        "file"
    )
    """``file``: each file of the source folder is a survey; ``folder``: each folder in it."""
    jobs: Annotated[int | None, Setting("Surveys mapped at a time", "N", 1, default="one per core if small")] = None
    """None: see `jobs_for`."""

    def __post_init__(self) -> None:
        check_settings(self)
        refuse_clashes(self.defaults, CLASHES)
        config = self.of_survey({})
        if (self.jobs or 1) > 1 and config.scheduler is not None:
            raise UsageError(
                f"jobs is {self.jobs} and scheduler is {config.scheduler!r}; surveys that its workers map are "
                "mapped one after another, each by all of them. Give `jobs=1`, or no `scheduler`"
            )
        self.share(config, self.jobs or 1)

    def merged(self, own: Mapping[str, Any]) -> dict[str, Any]:
        """Return the settings of one survey, with those that its row in the CSV gives."""
        return with_pixels(override_settings(override_settings(self.defaults, own, CLASHES), self.given, CLASHES))

    def of_survey(self, own: Mapping[str, Any], surveys: tuple[Path, ...] = (), name: str = "") -> MapConfig:
        """Return the settings of one survey, before resources are shared out.

        ``own``: settings of its row in the CSV; ``surveys``: its files and folders; ``name``: folder of its layers, in
        ``out``. Raises UsageError: a value that is not allowed.
        """
        return MapConfig(surveys=surveys, out=self.out / name, **self.merged(own))

    def jobs_for(self, sizes: Sequence[int]) -> int:
        """Return how many surveys of ``sizes`` bytes, 0 where that is not known, are mapped at a time.

        Without ``jobs``, and if all are small, which gives one survey little to do on several cores: one per thread, as
        far as there is memory for them.
        """
        most, config = self.jobs, self.of_survey({})
        if most is None:
            is_small = config.scheduler is None and min(sizes) > 0 and max(sizes) <= _SMALL
            most = min(config.threads, memory_limit(config.memory) // _JOB_MEMORY) if is_small else 1
        return max(1, min(most, len(sizes)))

    def share(self, config: MapConfig, jobs: int) -> MapConfig:
        """Return settings with the share of threads and memory that one of several jobs gets; of workers, all.

        Raises UsageError: ``memory`` is not a size, or too small for that number.
        """
        if config.scheduler is not None:
            return config
        threads = max(1, config.threads // jobs)
        if is_auto(config.memory):
            return replace(config, threads=threads, memory=f"{auto_memory(jobs) >> 20}MB")
        size = memory_bytes(config.memory) // jobs
        if size < LEAST_MEMORY:
            raise UsageError(
                f"memory is {config.memory!r}, which {jobs} jobs share; each needs {LEAST_MEMORY >> 20} MB. Give "
                f"{LEAST_MEMORY * jobs >> 20}MB or more, or fewer `jobs`"
            )
        return replace(config, threads=threads, memory=f"{size >> 20}MB")
