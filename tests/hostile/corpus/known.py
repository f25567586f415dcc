"""Faults that are known: name of the hostile file to what is wrong. A fault that is mended must leave this list."""

__all__ = ["KNOWN"]

_SPAN = "the message about the span of the survey does not name the file"

KNOWN = {
    "las12-points-one_2000_km_away.las": _SPAN,
    "values-too_wide.ply": _SPAN,
    "las12-points-2000_km_wide.las": "100 points along 2,000 km: writing the layers takes longer than 10 s",
}
