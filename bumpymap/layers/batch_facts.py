"""What a summary of many maps says of one: read from its run.json and the header of a raster."""

from pathlib import Path
from typing import Any

from bumpymap.core import CLASS_NAMES, BadInputError
from bumpymap.layers.manifest import read_manifest
from bumpymap.layers.remote_folder import RemoteFolder, open_raster

__all__ = ["map_facts"]

_BOUNDS = ("min_x", "min_y", "max_x", "max_y")
_RASTER = "class.tif"


def map_facts(folder: Path | RemoteFolder) -> dict[str, Any]:
    """Return the columns of a `SurveyRow` that follow from the layers of a complete map.

    Raises
    ------
    BadInputError
        The folder holds no complete map, or one that cannot be read.
    """
    manifest = _manifest_of(folder)
    try:
        return {**_counted(manifest), **_described(manifest), **_bounds(folder)}
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise BadInputError(f"the run.json in {_name(folder)} cannot be read as that of a map: {error!r}") from error


def _counted(manifest: dict[str, Any]) -> dict[str, Any]:
    counts, tiles = manifest["counts"], manifest["counts"]["tiles"]
    area = tiles * manifest["grid"]["tile_size_m"] ** 2
    reasons = counts["by_reason"]
    shares = {f"share_{name.replace(' ', '_')}": counts["by_class"][name] / tiles for name in CLASS_NAMES}
    return {
        "points": manifest["points"],
        "density": round(manifest["points"] / area, 4),
        "area": round(area, 2),
        "tiles": tiles,
        **{name: round(share, 6) for name, share in shares.items()},
        "share_passable": round(counts["passable"] / tiles, 6),
        "share_unknown": round(counts["unknown"] / tiles, 6),
        "unknown_reason": max(reasons, key=reasons.__getitem__) if reasons else None,
    }


def _described(manifest: dict[str, Any]) -> dict[str, Any]:
    crs, calibration = manifest["crs"], manifest["calibration"]
    sums = [str(file["checksum"]) for file in manifest["inputs"] if file.get("checksum")]
    return {
        "seconds": round(sum(manifest["seconds"].values()), 3),
        "crs": None if crs is None else crs["code"] or crs["name"],
        "vehicle": calibration["vehicle"],
        "calibration": calibration["id"],
        "checksum": " ".join(sums) or None,
        "warnings": tuple(map(str, manifest.get("warnings", ()))),
    }


def _bounds(folder: Path | RemoteFolder) -> dict[str, float]:
    with open_raster(folder, _RASTER) as raster:
        return dict(zip(_BOUNDS, map(float, raster.bounds), strict=True))


def _manifest_of(folder: Path | RemoteFolder) -> dict[str, Any]:
    if isinstance(folder, Path):
        return read_manifest(folder)
    found = folder.manifest()
    if found is None:
        raise BadInputError(f"{folder.url} holds no complete run: run.json is missing or not that of a map")
    return found


def _name(folder: Path | RemoteFolder) -> str:
    return str(folder) if isinstance(folder, Path) else folder.url
