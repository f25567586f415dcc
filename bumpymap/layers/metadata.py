"""What every layer says of its run: survey, vehicle, calibration, class limits, version, heights."""

from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from typing import Any

from bumpymap.core import Georeference, describe_crs, vertical_of
from bumpymap.layers.manifest import software_versions

__all__ = ["as_tags", "layer_metadata"]


def layer_metadata(manifest: Mapping[str, Any], place: Georeference) -> dict[str, Any]:
    """Return the entries that layers carry as metadata, as texts and lists of numbers; what is not known is left out.

    Parameters
    ----------
    manifest : mapping
        The run's own entries for run.json, see `complete_manifest`.
    place : Georeference
        CRS of the survey.

    Returns
    -------
    dict
        ``survey``, ``survey_checksum``, ``survey_header_dates`` (first/last, ISO 8601), ``vehicle``, ``calibration``,
        ``speed_m_per_s`` and ``p_fail_speed_m_per_s`` (of a map at another speed), ``texture_model``, ``rating``,
        ``class_limits_rad_per_m``, ``bumpymap_version``, ``vertical_crs``.
    """
    survey, calibration = (_entries(manifest.get(name)) for name in ("survey", "calibration"))
    settings = _entries(manifest.get("settings"))
    is_papers = settings.get("compat") == "paper"
    dates, limits = survey.get("dates"), calibration.get("class_limits")
    entries = {
        "survey": survey.get("name"),
        "survey_checksum": survey.get("checksum"),
        "survey_header_dates": "/".join(dates) if dates else None,
        "vehicle": calibration.get("vehicle"),
        "calibration": calibration.get("id"),
        # Without it the speed is that of the vehicle's profile.
        "speed_m_per_s": settings.get("speed"),
        "p_fail_speed_m_per_s": _entries(manifest.get("vehicle")).get("drives_mps") if settings.get("speed") else None,
        "texture_model": manifest.get("model"),
        "rating": "paper" if is_papers else settings.get("rating"),
        # The paper's classes follow from its table of textures and z ranges.
        "class_limits_rad_per_m": [float(limit) for limit in limits] if limits and not is_papers else None,
        "bumpymap_version": software_versions().get("bumpymap"),
        "vertical_crs": _vertical(place),
    }
    return {name: value for name, value in entries.items() if value is not None}


def as_tags(metadata: Mapping[str, Any]) -> dict[str, str]:
    """Return metadata as texts, for formats that hold nothing else; numbers of a list are separated by spaces."""
    return {
        name: " ".join(map(str, value)) if isinstance(value, list) else str(value) for name, value in metadata.items()
    }


def _entries(value: Any) -> Mapping[str, Any]:
    """Return an entry of a manifest, which may be a mapping or a record; nothing if there is none."""
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    return value if isinstance(value, Mapping) else {}


def _vertical(place: Georeference) -> str:
    vertical = None if place.crs is None else vertical_of(place.crs)
    if vertical is None:
        return "none given; heights as in the survey, in metres"
    return f"{describe_crs(vertical)}; heights in metres"
