"""Settings in messages, turned into options of the command line.

The library names a setting in backquotes, as an argument of a Python call: ``crs``, ``crs='EPSG:32614'``,
``overwrite=True``, ``tile_size=5``. The command line prints it as an option.
"""

import re
import shlex

__all__ = ["as_options"]

_SPELLED = {
    "start": "from",
    "goal": "to",
    "round_trip": "return",
    "radius_m": "robot-radius",
    "range_m": "range",
    "zone_starts_m": "zones",
    "band_hz": "band",
    "window_m": "window",
    "drives": "drive",
}
"""Options that do not have the name of the setting: ``from`` and ``return`` are words of Python."""
_SETTING = re.compile(r"`([a-z][a-z_]*)(?:=(?:'([^`]*)'|([^`'\s]+)))?`")


def as_options(text: str) -> str:
    """Replace the settings in backquotes by options: ``--crs EPSG:32614``, ``--overwrite``."""
    return _SETTING.sub(_option, text) if "`" in text else text


def _option(found: re.Match[str]) -> str:
    name, quoted, plain = found.groups()
    option = f"--{_SPELLED.get(name, name).replace('_', '-')}"
    if quoted is not None:
        return f"{option} {shlex.quote(quoted)}"
    return option if plain in {None, "True"} else f"{option} {plain}"
