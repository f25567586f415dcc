"""Settings of a batch, and those of the map of each survey: command line over CSV over TOML.

Layers that go to a server are made in a working folder of this machine, uploaded, and then removed there.
"""

import hashlib
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from os.path import lexists
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

from bumpymap.core import (
    CLASHES,
    LEAST_MEMORY,
    MapConfig,
    OutputError,
    UsageError,
    atomic,
    auto_memory,
    is_auto,
    is_own_folder,
    memory_bytes,
    override_settings,
    read_settings_file,
    refuse_clashes,
    writing_to,
)
from bumpymap.layers import BATCH_LOG, BATCH_NAMES, RemoteFolder, check_batch_out

__all__ = [
    "INDEX_NAME",
    "OWN_SETTINGS",
    "BatchConfig",
    "SurveyPer",
    "check_remote_out",
    "fetch_log",
    "naming_remote",
    "read_batch_settings",
    "upload_summary",
    "working_folder",
]

INDEX_NAME = "index.html"
"""The last file of a batch that is uploaded."""
_SUMMARY = "summary.csv"
_MAP = "run.json"


def working_folder(url: str, scratch: Path | None) -> Path:
    """Return the folder for the layers of a URL until they are uploaded: the same for every start of a batch."""
    digest = hashlib.sha256(url.rstrip("/").encode("utf-8", "surrogateescape")).hexdigest()[:16]
    return Path(scratch or tempfile.gettempdir()) / f"bumpymap-batch-{digest}"


def check_remote_out(remote: RemoteFolder, folder: Path) -> None:
    """Make the working folder, and check that no files but those of a batch are where its own would be uploaded.

    Raises
    ------
    OutputError
        There are; or the server or the working folder cannot be used.
    """
    with writing_to(folder, "`scratch`"):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not is_own_folder(folder, folder.parent):
            raise OutputError(
                f"{folder} is a link or belongs to another user, and was not touched: layers are made there before "
                "they are uploaded. Remove it, or choose another `scratch`"
            )
    present = remote.sizes()
    with tempfile.TemporaryDirectory() as name, naming_remote(remote, Path(name)):
        copy = Path(name)
        for known in {*BATCH_NAMES, _MAP} & set(present):
            data = remote.read(known) if known in {BATCH_LOG, _SUMMARY} else b""
            (copy / known).write_bytes(data or b"")
        check_batch_out(copy)


def fetch_log(remote: RemoteFolder, folder: Path) -> None:
    """Download the log of earlier starts, unless one that was interrupted has left it here."""
    log = folder / BATCH_LOG
    if not lexists(log) and (data := remote.read(BATCH_LOG)) is not None:
        with atomic(log) as temporary:
            temporary.write_bytes(data)


def upload_summary(remote: RemoteFolder, folder: Path) -> None:
    """Upload the summary, the page and the log, and remove them here.

    Raises
    ------
    OutputError
        The server cannot be used; the files stay here.
    """
    try:
        remote.upload(folder, INDEX_NAME)
    except OutputError as error:
        raise OutputError(f"{error}. The summary is in {folder}; the next start uploads it") from error
    for name in BATCH_NAMES:
        with suppress(FileNotFoundError):
            (folder / name).unlink()


@contextmanager
def naming_remote(remote: RemoteFolder, folder: Path) -> Iterator[None]:
    """Name the URL instead of a folder of this machine in the message of an error of the body."""
    try:
        yield
    except OutputError as error:
        raise OutputError(str(error).replace(str(folder), remote.url)) from error


SurveyPer: TypeAlias = Literal["file", "folder"]
OWN_SETTINGS = (
    "surveys",
    "out",
    "resume",
    "overwrite",
    "threads",
    "memory",
    "scratch",
    "scheduler",
)
"""Settings of a map that a batch decides for each survey, or shares out."""
_NOT_IN_A_FILE = ("surveys", "out", "resume")


@dataclass(frozen=True, slots=True)
class BatchConfig:
    """All settings of a ``batch`` run."""

    source: Path
    """A folder of surveys, a text file with a path in each line, or a CSV."""
    out: Path | str
    """Folder that gets a folder of layers for each survey; a string is an fsspec URL such as ``s3://bucket/night``."""
    given: Mapping[str, Any] = field(default_factory=dict)
    """Settings of `MapConfig` for all surveys; they override those of the CSV."""
    defaults: Mapping[str, Any] = field(default_factory=dict)
    """The same, of a settings file; the CSV overrides them."""
    survey_per: SurveyPer = "file"
    """``file``: each file of the source folder is a survey; ``folder``: each folder in it."""
    jobs: int = 1
    """Surveys that are mapped at a time."""

    def __post_init__(self) -> None:
        if isinstance(self.jobs, bool) or not isinstance(self.jobs, int) or self.jobs < 1:
            raise UsageError(f"`jobs` is {self.jobs!r}; it must be a whole number, at least 1")
        if self.survey_per not in get_args(SurveyPer):
            raise UsageError(f"`survey_per` is {self.survey_per!r}; it must be one of {', '.join(get_args(SurveyPer))}")
        refuse_clashes(self.defaults, CLASHES)
        config = self.of_survey({})
        if self.jobs > 1 and config.scheduler is not None:
            raise UsageError(
                f"jobs is {self.jobs} and scheduler is {config.scheduler!r}; surveys that its workers map are "
                "mapped one after another, each by all of them. Give `jobs=1`, or no `scheduler`"
            )
        self.share(config, self.jobs)

    @property
    def remote(self) -> RemoteFolder | None:
        """Where the layers go, if that is a server."""
        return RemoteFolder(self.out) if isinstance(self.out, str) else None

    @property
    def folder(self) -> Path:
        """Folder on this machine: ``out``, or the one in which layers are made before they are uploaded."""
        if isinstance(self.out, Path):
            return self.out
        scratch = self.given.get("scratch", self.defaults.get("scratch"))
        return working_folder(self.out, scratch)

    @property
    def overwrite(self) -> bool:
        """True: layers that were made from other inputs or settings are replaced."""
        return bool(self.given.get("overwrite", self.defaults.get("overwrite", False)))

    def merged(self, own: Mapping[str, Any]) -> dict[str, Any]:
        """Return the settings of one survey, with those that its row in the CSV gives."""
        settings = override_settings(override_settings(self.defaults, own, CLASHES), self.given, CLASHES)
        settings.pop("overwrite", None)
        return settings

    def of_survey(self, own: Mapping[str, Any], surveys: tuple[Path | str, ...] = (), name: str = "") -> MapConfig:
        """Return the settings of one survey, before resources are shared out.

        Parameters
        ----------
        own : mapping
            Settings of its row in the CSV.
        surveys : tuple of Path or str
            Its files and folders.
        name : str
            Folder of its layers, in ``out``.

        Raises
        ------
        UsageError
            A value that is not allowed.
        """
        config = MapConfig(surveys=surveys, out=self.folder / name, **self.merged(own))
        if self.remote is not None and config.sheets is not None:
            raise UsageError(
                f"sheets is {config.sheets:g}, and layers in sheets cannot be uploaded to {self.out}. Give a folder of "
                "this machine as `out`, or no `sheets`"
            )
        return config

    def share(self, config: MapConfig, jobs: int) -> MapConfig:
        """Return settings with the share of threads and memory that one of so many jobs gets; of workers, all.

        Raises
        ------
        UsageError
            ``memory`` is not a size, or too small for so many.
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


def read_batch_settings(path: Path) -> dict[str, Any]:
    """Read the settings of all surveys from a TOML file, which has the form of one for ``map``.

    Raises
    ------
    UsageError
        The file cannot be read, or sets what a batch decides for each survey.
    """
    found = read_settings_file(path, MapConfig)
    if wrong := [name for name in _NOT_IN_A_FILE if name in found]:
        raise UsageError(
            f"{path}: a batch has no setting {', '.join(wrong)}: the source names the surveys, and each gets a folder "
            "in `out`. Remove it from the file"
        )
    return found
