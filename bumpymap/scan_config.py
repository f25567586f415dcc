"""Settings of a scan run: one tree of defaults that works with no file. Unknown keys are refused."""

import tomllib
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from bumpymap.config import Compat
from bumpymap.errors import UsageError
from bumpymap.frames import Robot
from bumpymap.scan import PolarSettings, ScanMethod

__all__ = ["SCAN_PRODUCTS", "ScanConfig", "ScanProduct", "read_scan_settings"]

ScanProduct = Literal["polygons", "table", "cloud", "picture"]
SCAN_PRODUCTS: tuple[ScanProduct, ...] = get_args(ScanProduct)


@dataclass(frozen=True, slots=True)
class ScanConfig:
    """Everything that a scan run depends on."""

    frames: tuple[Path, ...]
    """Files of scans, or folders of them."""
    out: Path
    """Folder for the products; of a fit, the file for the stripe classes."""
    poses: Path | None = None
    """Where the sensor was at each frame; the frames are then gathered and mapped like a survey."""
    crs: str | None = None
    """CRS of the poses, in metres; None: local coordinates."""
    method: ScanMethod | None = None
    """How sectors are classed; None: learned where a network ships that knows the grid, else filter."""
    model: Path | None = None
    """A scan network; instead of the one that ships."""
    stripes: Path | None = None
    """Stripe classes of the filter method; instead of those that ship."""
    compat: Compat = "none"
    """``paper``: fit the stripe classes anew in every scan, as the paper does."""
    products: tuple[ScanProduct, ...] = SCAN_PRODUCTS
    """What is written of the frames."""
    vehicle: str | None = None
    """Vehicle of the mapped layers, whose calibration ships; None: that of ``bumpymap map``."""
    calibration: Path | None = None
    """A calibration file for the mapped layers; instead of ``vehicle``."""
    skip_bad: bool = False
    """Go on without the frames that cannot be read."""
    overwrite: bool = False
    """Replace the products of an earlier run."""
    polar: PolarSettings = field(default_factory=PolarSettings)
    robot: Robot = field(default_factory=Robot)

    def __post_init__(self) -> None:
        unknown = sorted(set(self.products) - set(SCAN_PRODUCTS))
        if unknown or not (self.products or self.poses):
            raise UsageError(
                f"products are {', '.join(self.products) or 'none'}; give one or more of {', '.join(SCAN_PRODUCTS)}"
            )
        learned, own_filter = self.method == "learned", self.stripes is not None or self.compat == "paper"
        if (learned and own_filter) or (self.method == "filter" and self.model) or (self.model and own_filter):
            raise UsageError(
                "--model belongs to the learned method, --stripes and --compat paper to the filter; give options of one"
            )
        if self.stripes is not None and self.compat == "paper":
            raise UsageError("--compat paper fits stripe classes in every scan, so it cannot use those of --stripes")
        maps = [name for name in ("crs", "vehicle", "calibration") if getattr(self, name) is not None]
        if maps and self.poses is None:
            raise UsageError(
                f"--{maps[0]} is about the map of a drive, which needs the place of every frame: add --poses FILE"
            )


def read_scan_settings(path: Path) -> dict[str, Any]:
    """Read settings of ``ScanConfig`` from a TOML file; relative paths in it start at its folder.

    Raises
    ------
    UsageError
        No such file, not TOML, an unknown key, a value of the wrong type or out of bounds.
    """
    try:
        record = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UsageError(f"cannot read settings from {path}: {error}") from error
    return _settings(record, ScanConfig, str(path), path.parent)


def _settings(record: dict[str, Any], owner: type, origin: str, folder: Path) -> dict[str, Any]:
    known: dict[str, Any] = {f.name: f.type for f in fields(owner)}
    unknown = sorted(set(record) - set(known))
    if unknown:
        raise UsageError(f"{origin}: unknown setting {', '.join(unknown)}; there are: {', '.join(known)}")
    return {name: _value(value, known[name], f"{origin}: {name}", folder) for name, value in record.items()}


def _value(value: Any, kind: Any, name: str, folder: Path) -> Any:
    """Return a TOML value as the setting's type; texts become paths below ``folder`` where paths are wanted."""
    if get_args(kind)[1:] == (NoneType,):  # whoever wants None leaves the setting out
        kind = get_args(kind)[0]
    items = get_args(kind)
    word = getattr(kind, "__name__", str(kind))
    if is_dataclass(kind):
        if isinstance(value, dict):
            return kind(**_settings(value, kind, f"{name} table", folder))  # type: ignore[arg-type, operator]
        word = "a table"
    elif get_origin(kind) is tuple:
        if isinstance(value, list) and (items[-1] is Ellipsis or len(items) == len(value)):
            return tuple(_value(item, items[0], name, folder) for item in value)
        word = f"a list of {'' if items[-1] is Ellipsis else f'{len(items)} '}values"
    elif get_origin(kind) is Literal:
        if value in items:
            return value
        word = f"one of {', '.join(items)}"
    elif kind is Path and isinstance(value, str):
        return folder / value
    elif (kind is float and type(value) is int) or type(value) is kind:
        return kind(value)
    raise UsageError(f"{name} is {value!r}; it must be {_WORDS.get(kind, word)}")


_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text", Path: "a text"}
