"""Refuse surveys that are not in a projected CRS, with the command that reprojects the file."""

import shlex
from dataclasses import dataclass
from pathlib import Path

from pyproj import CRS, Transformer

from bumpymap.core.errors import BadInputError

__all__ = ["FORCE_CRS", "SAY_CRS", "Place", "describe_crs", "refuse_unprojected", "reproject_command", "utm_epsg"]

_ZONE = "where ZZ is the UTM zone, (longitude + 180) / 6 + 1 (327ZZ in the south)"
SAY_CRS = "Say which CRS the coordinates are in with `crs`, such as `crs='EPSG:32614'`"
FORCE_CRS = "Override it with `force_crs`, such as `force_crs='EPSG:32614'`"
"""For files that state no CRS, and for those that state a wrong one."""


@dataclass(frozen=True, slots=True)
class Place:
    """A file and the centre of its extent in the file's units (None if unknown), for messages."""

    path: Path | str
    middle: tuple[float, float, float] | None = None


def describe_crs(crs: CRS) -> str:
    """Return name and code, such as ``WGS 84 / UTM zone 14N (EPSG:32614)``; or ``(EPSG:32614+5703)`` if compound."""
    parts = crs.sub_crs_list if crs.is_compound and crs.to_epsg() is None else [crs]
    codes = [part.to_epsg() for part in parts]
    code = "" if None in codes else "+".join(map(str, codes))
    return f"{crs.name} (EPSG:{code})" if code else crs.name


def refuse_unprojected(place: Place, crs: CRS, *, from_user: bool) -> None:
    """Raise BadInputError unless the CRS is a projected or a local (engineering) one.

    Parameters
    ----------
    place : Place
    crs : pyproj.CRS
    from_user : bool
        Whether the CRS came from ``--crs``, so that the command that reprojects must name it too.

    Raises
    ------
    BadInputError
        The CRS is geographic or geocentric (the message shows the command that reprojects the file), or vertical only.
    """
    base = crs.sub_crs_list[0] if crs.is_compound else crs
    if base.is_projected or base.type_name == "Engineering CRS":
        return
    if base.is_vertical:
        raise BadInputError(f"{describe_crs(crs)} is a vertical CRS and does not locate {place.path}. {SAY_CRS}")
    what = "Earth-centred coordinates" if base.is_geocentric else "degrees"
    longitude_latitude = _longitude_latitude(place, base)
    if longitude_latitude is None and place.middle is not None:
        shown = ", ".join(f"{value:.10g}" for value in place.middle[:2])
        raise BadInputError(
            f"{place.path} is stated to be in {what} ({describe_crs(crs)}), but its centre lies at {shown}, which is "
            f"not such a place. {FORCE_CRS}"
        )
    source = crs.to_string() if from_user else None
    raise BadInputError(
        f"{place.path} is in {what} ({describe_crs(crs)}); bumpymap measures in metres and needs a projected CRS. "
        "Reproject it first:",
        f"  {reproject_command(place.path, longitude_latitude, source)}",
        *([] if longitude_latitude else [_ZONE]),
    )


def _longitude_latitude(place: Place, crs: CRS) -> tuple[float, float] | None:
    """Return the centre of the file, degrees; None if it is unknown or not a location on Earth."""
    if place.middle is None:
        return None
    longitude, latitude, height = place.middle
    if crs.is_geocentric:
        longitude, latitude, _ = Transformer.from_crs(crs, 4979, always_xy=True).transform(longitude, latitude, height)
    inside = abs(longitude) <= 360 and abs(latitude) <= 90
    return (longitude, latitude) if inside else None


def utm_epsg(longitude: float, latitude: float) -> int:
    """Return the EPSG code of the WGS 84 / UTM zone of a location, or of polar stereographic beyond 84 N or 80 S.

    Examples
    --------
    >>> utm_epsg(-99.1, 19.4), utm_epsg(-58.4, -34.6), utm_epsg(180.0, 10.0)
    (32614, 32721, 32601)
    """
    if latitude >= 84:
        return 5041
    if latitude < -80:
        return 5042
    zone = int((longitude + 180) // 6) % 60 + 1
    return (32600 if latitude >= 0 else 32700) + zone


def reproject_command(path: Path | str, longitude_latitude: tuple[float, float] | None, source: str | None) -> str:
    """Return the PDAL command that reprojects a file from degrees to metres, with a resolution of 1 mm.

    Parameters
    ----------
    path : Path or str
    longitude_latitude : (float, float) or None
        Location of the file, degrees; None: the user must fill in the UTM zone.
    source : str or None
        CRS of the file, if the file itself does not state it.
    """
    target = "EPSG:326ZZ" if longitude_latitude is None else f"EPSG:{utm_epsg(*longitude_latitude)}"
    words = ["pdal", "translate", shlex.quote(str(path)), shlex.quote(f"{Path(path).name.split('.')[0]}_metres.laz")]
    words += ["reprojection", f"--filters.reprojection.out_srs={target}"]
    words += [f"--filters.reprojection.in_srs={shlex.quote(source)}"] if source else []
    words += [f"--writers.las.scale_{axis}=0.001 --writers.las.offset_{axis}=auto" for axis in "xyz"]
    return " ".join(words)
